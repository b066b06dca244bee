"""Explanation of a race as text: observation, move, reason and consequence of each decision."""

import numpy as np

from pcs_racing.game.characteristics import get_characteristics
from pcs_racing_agents.watch.explain import ExplainedDecision, Explanation

CLEAR = 0.1
"""Min normalised distance from the archive's middle for an adjective."""
LEVEL = 0.3  # max lead of side-by-side cars, m: about a car's length

ADJECTIVES = {
    "aggressiveness": ("aggressive", "restrained"),
    "pace": ("fast", "slow"),
    "speed": ("fast", "slow"),
    "restraint": ("careful", "daring"),
    "smoothness": ("smooth", "restless"),
    "blocking": ("blocking", "not blocking"),
}
"""Adjectives for a high and a low value of a characteristic."""


def story(explanation: Explanation) -> str:
    """Return the explanation as text: a head and some lines per move."""
    me, other = explanation.names[explanation.car], explanation.names[1 - explanation.car]
    # Names of two equal competitors already end in the car's number.
    number = f" (car {explanation.car})"
    lines = [
        f"{me.removesuffix(number)}{number} against {other} on {explanation.replay.track_name}, "
        f"{explanation.race} rules: {explanation.replay.outcome}"
    ]
    if explanation.open_loop:
        lines.append(f"{me} makes open-loop moves: what is seen below does not change them.")
    for k, step in enumerate(explanation.steps):
        lines += [
            (
                f"{step.time:5.1f} s  saw: {opponent_words(explanation, step)};"
                f" {lead_words(step.lead)}."
            ),
            f"         did: {move_words(explanation, step)}.",
        ]
        reason = why(explanation, step)
        if reason:
            lines.append(f"         why: {reason}.")
        lines.append(f"         then: {_what_followed(explanation, k)}.")
    if not explanation.steps:
        lines.append("The race was over before the first move.")
    return "\n".join(lines)


def opponent_words(explanation: Explanation, step: ExplainedDecision) -> str:
    """Describe the observed opponent, e.g. "opponent restrained (pace 0.21 below the middle)"."""
    names = [axis.name for axis in get_characteristics(explanation.archive.characteristics)]
    distances = step.opponent - explanation.middle
    adjectives, numbers = [], []
    for name, distance in zip(names, distances, strict=True):
        much, little = ADJECTIVES.get(name, (f"high in {name}", f"low in {name}"))
        if abs(distance) >= CLEAR:
            adjectives.append(much if distance > 0.0 else little)
        side = "above" if distance > 0.0 else "below"
        numbers.append(f"{name} {abs(distance):.2f} {side} the middle")
    return (
        f"opponent {' and '.join(adjectives) or 'in the middle of the archive'}"
        f" ({', '.join(numbers)})"
    )


def lead_words(lead: float) -> str:
    """Describe a lead."""
    if abs(lead) < LEVEL:
        return "level"
    return f"{'ahead' if lead > 0.0 else 'behind'} by {abs(lead):.1f} m"


def move_words(explanation: Explanation, step: ExplainedDecision) -> str:
    """Describe the move and the change of policy."""
    name = explanation.moves[step.move]
    chance = (
        "" if step.probabilities is None or step.probabilities[step.move] > 0.999 else _drawn(step)
    )
    if step.next_policy == step.policy:
        unchanged = f"kept policy {step.policy}"
        return (
            f"{name}{chance}, {unchanged}"
            if name == "stay"
            else f"{name}{chance}, no policy lies that way: {unchanged}"
        )
    points = explanation.archive.normalised
    axes = get_characteristics(explanation.archive.characteristics)
    changes = ", ".join(
        f"{axis.name} {before:.2f} to {after:.2f}"
        for axis, before, after in zip(
            axes, points[step.policy], points[step.next_policy], strict=True
        )
    )
    return f"{name}{chance}, from policy {step.policy} to {step.next_policy} ({changes})"


def _drawn(step: ExplainedDecision) -> str:
    assert step.probabilities is not None
    return f" (drawn with a chance of {step.probabilities[step.move]:.0%})"


def why(explanation: Explanation, step: ExplainedDecision) -> str:
    """Describe the value of the move relative to other moves; empty without values."""
    values, unit = step.values, explanation.unit
    if values is None or unit is None:
        return ""
    if step.next_policy == step.policy and explanation.moves[step.move] != "stay":
        return "it keeps the policy, so its value is that of staying"
    names = explanation.moves
    best = int(np.argmax(values))
    if step.move >= len(values):
        return f"its network has no value for {names[step.move]}"
    others = [i for i in range(len(values)) if i != step.move]
    if not others:
        return "there is no other move"
    # Compared with "stay" where its value is known: the main question is whether to switch at all.
    stay = len(names) - 1
    second = max(others, key=lambda i: values[i])
    against = stay if stay < len(values) and step.move != stay and names[stay] == "stay" else second
    gain = _difference(explanation, values[step.move] - values[against])
    text = f"worth {gain} than {'staying' if names[against] == 'stay' else names[against]}"
    if against != second:
        text += (
            f", {_difference(explanation, values[step.move] - values[second])} than {names[second]}"
        )
    if unit.text == "" and values[step.move] == values[best]:
        text = f"the highest value of all moves, {text}"
    return text if unit.text else f"{text} (relative values, without a unit)"


def _difference(explanation: Explanation, difference: float) -> str:
    return f"{_amount(explanation, abs(difference))} {'more' if difference >= 0.0 else 'less'}"


def _amount(explanation: Explanation, value: float) -> str:
    """Return a difference of two values, with its unit."""
    unit = explanation.unit
    assert unit is not None
    digits = {"of a win": ".3f", "": ".3g"}.get(unit.text, ".2f")
    return f"{unit.scale * value:{digits}} {unit.text}".rstrip()


def _what_followed(explanation: Explanation, k: int) -> str:
    """Describe the change of the lead and the events of the next step."""
    step, replay = explanation.steps[k], explanation.replay
    end = explanation.ends[k + 1]
    # A crash ends the replay before the end of the step.
    frame = min(round(end / replay.frame_dt), len(replay.cars) - 1)
    gained = float(explanation.lead[frame]) - step.lead
    events = [
        f"{'it' if event.car == explanation.car else 'the opponent'} {event.text} at"
        f" {event.time:.1f} s"
        for event in replay.events
        if event.kind != "move" and step.time < event.time <= end + 1e-9
    ]
    change = (
        "no change"
        if abs(gained) < 0.05
        else f"{'gained' if gained > 0.0 else 'lost'} {abs(gained):.1f} m"
    )
    change += f", {lead_words(float(explanation.lead[frame]))}"
    return "; ".join([change, *events])
