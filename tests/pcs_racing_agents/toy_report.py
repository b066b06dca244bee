"""A report with everything in it, whose texts would break out of the page if they could."""

from typing import Any

from pcs_racing_agents.study.report import TitledTable

NASTY = '</script><script>document.title="owned"</script><b>&amp;"\'<!--body-->'


def toy_report() -> dict[str, Any]:
    """Return the arguments of a report."""
    return {
        "title": f"A study {NASTY}",
        "facts": f"Races {NASTY}",
        "about": f"{NASTY}\n\nSecond paragraph.",
        "findings": [NASTY, NASTY],
        "caution": NASTY,
        "tables": [
            TitledTable("Results", [("change", "gain"), (NASTY, "+0.05")], NASTY),
            TitledTable(NASTY, [("change",), ("none",)]),
        ],
        "settings": {"race": NASTY, "tracks": ["a", "b"]},
    }
