"""Explanation of a race as text: observation, move, reason and consequence of each decision."""

import numpy as np

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
    replay, car = explanation.replay, explanation.car
    me, other = replay.car_names[car], replay.car_names[1 - car]
    # Names of two equal competitors already end in the car's number.
    number = f" (car {car})"
    lines = [
        f"{me.removesuffix(number)}{number} against {other} on {replay.track_name},"
        f" {explanation.game.rules.name} rules: {replay.outcome}"
    ]
    if explanation.open_loop:
        lines.append(f"{me} makes open-loop moves: the observations below do not change them.")
    for k, step in enumerate(explanation.steps):
        seen = f"{opponent_words(explanation, step)}; {lead_words(step.lead)}"
        lines.append(f"{step.time:5.1f} s  saw: {seen}.")
        lines.append(f"         did: {move_words(explanation, step)}.")
        if reason := why(explanation, step):
            lines.append(f"         why: {reason}.")
        lines.append(f"         then: {_what_followed(explanation, k)}.")
    if not explanation.steps:
        lines.append("The race was over before the first move.")
    return "\n".join(lines)


def opponent_words(explanation: Explanation, step: ExplainedDecision) -> str:
    """Describe the observed opponent, e.g. "opponent restrained (pace 0.21 below the middle)"."""
    axes = explanation.game.archive.characteristics
    adjectives, numbers = [], []
    for name, distance in zip(axes, step.opponent - explanation.middle, strict=True):
        much, little = ADJECTIVES.get(name, (f"high in {name}", f"low in {name}"))
        if abs(distance) >= CLEAR:
            adjectives.append(much if distance > 0.0 else little)
        side = "above" if distance > 0.0 else "below"
        numbers.append(f"{name} {abs(distance):.2f} {side} the middle")
    kind = " and ".join(adjectives) or "in the middle of the archive"
    return f"opponent {kind} ({', '.join(numbers)})"


def lead_words(lead: float) -> str:
    """Describe a lead."""
    if abs(lead) < LEVEL:
        return "level"
    return f"{'ahead' if lead > 0.0 else 'behind'} by {abs(lead):.1f} m"


def move_words(explanation: Explanation, step: ExplainedDecision) -> str:
    """Describe the move and the change of policy."""
    archive, text = explanation.game.archive, explanation.game.moves[step.move]
    unchanged = f"kept policy {step.policy}"
    if text != "stay":
        unchanged = f"no policy lies that way: {unchanged}"
    if step.probabilities is not None and step.probabilities[step.move] <= 0.999:
        text += f" (drawn with a chance of {step.probabilities[step.move]:.0%})"
    if step.next_policy == step.policy:
        return f"{text}, {unchanged}"
    before, after = archive.normalised[[step.policy, step.next_policy]]
    changes = ", ".join(
        f"{name} {old:.2f} to {new:.2f}"
        for name, old, new in zip(archive.characteristics, before, after, strict=True)
    )
    return f"{text}, from policy {step.policy} to {step.next_policy} ({changes})"


def why(explanation: Explanation, step: ExplainedDecision) -> str:
    """Describe the value of the move relative to other moves; empty without values."""
    values, names = step.values, explanation.game.moves
    if values is None:
        return ""
    if step.next_policy == step.policy and names[step.move] != "stay":
        return "it keeps the policy, so its value is the value of staying"
    if step.move >= len(values):
        return f"its network has no value for {names[step.move]}"
    others = [i for i in np.argsort(-values).tolist() if i != step.move]
    # The main question is whether to switch at all: "stay" comes first where its value is known.
    compared = dict.fromkeys([*(i for i in others if names[i] == "stay"), *others[:1]])
    gains = [
        f"{_difference(values[step.move] - values[i], explanation.unit)} than"
        f" {'staying' if names[i] == 'stay' else names[i]}"
        for i in compared
    ]
    note = "" if explanation.unit else " (relative values)"
    return f"worth {', '.join(gains)}{note}" if gains else "there is no other move"


def _difference(difference: float, unit: str) -> str:
    """Return a difference of two values, e.g. "0.100 of a win more"."""
    digits = {"of a win": ".3f", "m of lead": ".2f"}.get(unit, ".3g")
    amount = f"{abs(difference):{digits}} {unit}".rstrip()
    return f"{amount} {'more' if difference >= 0.0 else 'less'}"


def _what_followed(explanation: Explanation, k: int) -> str:
    """Describe the change of the lead and the events of the next step."""
    step, replay, end = (
        explanation.steps[k],
        explanation.replay,
        explanation.game.rules.ends[k + 1],
    )
    # A crash ends the replay before the end of the step.
    frame = min(round(end / replay.frame_dt), len(replay.cars) - 1)
    lead = float(explanation.lead[frame])
    gained = lead - step.lead
    change = f"{'gained' if gained > 0.0 else 'lost'} {abs(gained):.1f} m"
    events = [
        f"{'it' if event.car == explanation.car else 'the opponent'} {event.text} at"
        f" {event.time:.1f} s"
        for event in replay.events
        if event.kind != "move" and step.time < event.time <= end + 1e-9
    ]
    change = "no change" if abs(gained) < 0.05 else change
    return "; ".join([f"{change}, {lead_words(lead)}", *events])
