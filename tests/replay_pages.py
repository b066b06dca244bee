"""Races read from pages, as the script of the pages reads them."""

import base64
import json
import re
import zlib

import numpy as np


def unpack(packed):
    """The array that `pcs_racing.base.packing.pack` packed."""
    numbers = json.loads(zlib.decompress(base64.b64decode(packed["data"])))
    whole = np.reshape(np.array(numbers, np.int64), packed["shape"])
    for axis in packed["differences"]:
        whole = np.cumsum(whole, axis=axis)
    return whole / packed["per_unit"]


def race_in(page):
    """The values of a replay's page, arrays unpacked."""
    values = json.loads(re.search(r'id="replay">(.*?)</script>', page, re.DOTALL)[1])
    return {
        name: unpack(value) if isinstance(value, dict) and "data" in value else value
        for name, value in values.items()
    }
