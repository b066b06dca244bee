"""Videos of environments with many frames in a step."""

from typing import Any

from gymnasium.wrappers import RecordVideo


class RecordRaces(RecordVideo[Any, Any]):
    """Gymnasium's :class:`gymnasium.wrappers.RecordVideo`, with all frames of a step.

    A step of a duel lasts 8 s. With ``render_mode="rgb_array_list"`` the environment returns 200
    frames for a step; their rate, 25 a second, is in its metadata. Gymnasium's own wrapper writes
    only the last frame of such a list. This wrapper takes the same arguments and also needs
    moviepy. A video started in the middle of an episode shows the episode from its start. A game of
    40 s at 960 x 640 pixels takes 1.8 GB of memory until its video is written;
    ``render_size=(480, 320)`` takes a quarter.

    Examples
    --------
    >>> from pcs_racing.envs.duel import DuelEnv
    >>> from pcs_racing.envs.video import RecordRaces
    >>> env = DuelEnv(render_mode="rgb_array_list", render_size=(480, 320))
    >>> env = RecordRaces(env, "videos")  # doctest: +SKIP
    """

    def reset(self, **arguments: Any) -> tuple[Any, dict[str, Any]]:
        """Begin an episode, and a video if it is due."""
        self.render_history = []
        result = super().reset(**arguments)
        self._spread()
        return result

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Make a step and add its frames to the video."""
        result = super().step(action)
        self._spread()
        return result

    def _spread(self) -> None:
        """Replace the last frame of the last step by all its frames."""
        if self.recording and self.recorded_frames and self.render_history:
            self.recorded_frames[-1:] = self.render_history
        self.render_history = []
