"""Pages: Jinja templates with a common head and the look of a replay.

``page.html`` is the head of all pages, ``document.html`` the page of a result: its name, one
sentence and a line of facts, then pictures and tables. Colours and controls are the shared part
``look`` of ``pcs_racing/race/replay.html``.
"""

import re
from collections.abc import Mapping
from typing import Any

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from pcs_racing.race.replay import player_page, replay_page, safe_json
from pcs_racing_agents.base.folders import package_version
from pcs_racing_agents.base.tables import is_number

_SHARED = re.compile(r"/\* shared: (\w+) \*/(.*?)/\* end of shared \*/", re.DOTALL)


def rendered(
    package: str, name: str, filters: Mapping[str, Any] | None = None, **values: Any
) -> str:
    """Return a page from a template of a package; all text is escaped.

    The filter ``page`` embeds a replay, the filter ``json`` writes values into a script element;
    ``filters`` are further ones. ``look`` is the shared style, ``colours`` and ``reading`` are
    shared parts of a script.
    """
    environment = Environment(
        loader=ChoiceLoader(
            [PackageLoader(one, "") for one in (package, "pcs_racing_agents.watch")]
        ),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"page": replay_page, "json": _json, **(filters or {})}
    environment.tests["number"] = is_number
    shared = {part: Markup(text.strip()) for part, text in _SHARED.findall(player_page())}
    version = f"pcs-racing {package_version()}"
    return environment.get_template(name).render(version=version, **shared, **values)


def _json(values: Any) -> Markup:
    """Return values as JSON that needs no escaping."""
    return Markup(safe_json(values))
