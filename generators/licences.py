"""Licences of what is installed with flexfmu: a line per package, as its metadata states it. `make licences` prints them."""

from __future__ import annotations

import re
from importlib.metadata import Distribution, PackageNotFoundError, distribution

LONGEST = 60
"""Characters of a licence; some packages have its whole text in that field."""


INSIDE = {"uPlot": ("1.6.32", "MIT")}
"""What the package has inside, in cosim/reports/uplot: version and licence."""


def installed_with(name: str, found: dict[str, Distribution] | None = None) -> dict[str, Distribution]:
    """The package and all that it needs, by name, as far as they are installed; without what extras add."""
    found = {} if found is None else found
    key = re.sub(r"[-_.]+", "-", name).lower()
    if key not in found:
        try:
            found[key] = distribution(name)
        except PackageNotFoundError:  # needed on other platforms alone
            return found
        for requirement in found[key].requires or ():
            if "extra ==" not in requirement and (wanted := re.match(r"[\w.-]+", requirement)):
                installed_with(wanted[0], found)
    return found


def licence(package: Distribution) -> str:
    """Expression, classifiers or the first line of the text, in this order."""
    stated = package.metadata
    classifiers = [each.rpartition(" :: ")[2] for each in stated.get_all("Classifier") or () if "License ::" in each]
    text = (stated.get("License") or "").strip().partition("\n")[0][:LONGEST]
    classifiers = [each for each in classifiers if each != "OSI Approved"]  # which says only that it is open
    return stated.get("License-Expression") or ", ".join(classifiers) or text or "not stated"


if __name__ == "__main__":
    for _name, _package in sorted(installed_with("flexfmu").items()):
        print(f"{_name:24} {_package.version:16} {licence(_package)}")
    for _name, _facts in INSIDE.items():
        print(f"{_name:24} {_facts[0]:16} {_facts[1]}")
