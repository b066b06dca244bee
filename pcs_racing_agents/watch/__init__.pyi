from .explain import explain_race as explain_race, mark_moves as mark_moves
from .frames import write_gif as write_gif
from .ros_messages import (
    RosMessage as RosMessage,
    map_message as map_message,
    pose_messages as pose_messages,
    scan_message as scan_message,
)
from .words import story as story

__all__ = [
    "RosMessage",
    "explain_race",
    "map_message",
    "mark_moves",
    "pose_messages",
    "scan_message",
    "story",
    "write_gif",
]
