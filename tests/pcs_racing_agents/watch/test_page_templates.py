"""The sentence that pages of results begin with."""

import pytest

from pcs_racing_agents.watch.pages import Standing, winner_text


@pytest.mark.parametrize(
    ("scores", "words"),
    [
        ([0.7], "a scores highest: 0.700 [0.600, 0.800] over 1,200 races."),
        ([0.7, 0.5, 0.4], "1,200 races; then: b 0.500, c 0.400."),
        ([0.7, 0.65, 0.4], "1,200 races; within this interval: b 0.650."),
        (
            [0.7, 0.7, 0.69, 0.68, 0.61, 0.6, 0.5],
            "1,200 races; within this interval: b 0.700, c 0.690, d 0.680 and 2 more.",
        ),
    ],
)
def test_the_winner_is_named_with_the_agents_that_are_as_good(scores, words):
    standings = [
        Standing(name, score, score - 0.1, score + 0.1, 1200)
        for name, score in zip("abcdefg", scores, strict=False)
    ]
    assert winner_text(standings).endswith(words)
