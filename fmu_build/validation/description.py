"""Checks of modelDescription.xml.

Unit definitions (SI exponents, factors) must match the names of the units; ambiguous names, such as a/b.c, are not checked. Source:
BIPM, The International System of Units, 9th edition.
"""

from __future__ import annotations

import keyword
import math
import re
from collections import Counter
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from fmpy.model_description import read_model_description
from fmpy.validation import validate_fmu as validate_by_fmpy

from flexfmu.fmu_build.units import COHERENT
from flexfmu.fmu_build.validation.finding import Finding, Severity

_NUMBERS = {"Real", "Integer", "Enumeration"}
_SETTABLE = {"input", "parameter"}
_IDENTIFIER = re.compile(r"[A-Za-z_]\w*", re.ASCII)
_FMPY_ERRORS = {"list index out of range", "'NoneType' object has no attribute 'get'"}
"""Messages of Python exceptions that fmpy reports as problems of the description."""

_UNREADABLE = "fmpy cannot read modelDescription.xml"
_ENCODING = re.compile(rb"""<\?xml[^>]*encoding\s*=\s*["']([^"']+)""")


def fmi_version(content: bytes) -> str:
    """The attribute fmiVersion of a modelDescription.xml; empty if it is missing."""
    match = re.search(rb"""<fmiModelDescription[^>]*?\sfmiVersion\s*=\s*["']([^"']*)""", content, re.DOTALL)
    return match.group(1).decode(errors="replace") if match else ""


def read_description(path: Path) -> tuple[Any | None, list[Finding]]:
    """The description as read by fmpy, None if fmpy can't read it; and the findings of fmpy's rules."""
    findings = [_broken(problem) for problem in validate_by_fmpy(str(path)) if "contains a backslash" not in problem]
    # where fmpy crashes, `check_description` usually finds the cause; otherwise its message remains
    failures = [problem for problem in findings if problem.message in _FMPY_ERRORS]
    findings = [problem for problem in findings if problem not in failures]
    findings += [_broken(f"{_UNREADABLE}: {problem.message}") for problem in failures[:1]]
    try:
        return read_model_description(str(path), validate=False), findings
    except Exception as error:  # fmpy and lxml raise many types for a broken description
        return None, findings or [_broken(str(error))]


def is_fmpy_error(finding: Finding) -> bool:
    """Whether a finding reports only that fmpy can't read the description."""
    return finding.message.startswith(_UNREADABLE)


def check_description(content: bytes) -> Iterator[Finding]:
    """Yield findings that fmpy's rules don't cover.

    Args:
        content: bytes of modelDescription.xml.
    """
    # encoding and document type
    encoding = _ENCODING.match(content)
    if encoding and encoding[1].lower() not in (b"utf-8", b"utf8", b"us-ascii"):
        message = f"modelDescription.xml is encoded as {encoding[1].decode(errors='replace')}"
        yield Finding("model description", message, "use UTF-8", Severity.WARNING)
    if b"<!DOCTYPE" in content:
        message = "modelDescription.xml has a document type (<!DOCTYPE ...>), which tools refuse for safety"
        yield Finding("model description", message, "leave it out", Severity.WARNING)
    try:
        root = ElementTree.fromstring(content)
    except (ElementTree.ParseError, LookupError, ValueError):  # fmpy's rules report it
        return
    # attributes, default experiment, units
    yield from _check_root(root)
    yield from _check_experiment(root)
    try:
        yield from check_units(root)
    except ValueError as error:  # not a number
        yield Finding("units", " ".join(str(error).split()), "give numbers")
    # each variable alone, then all of them together
    variables = root.findall("ModelVariables/ScalarVariable")
    for variable in variables:
        yield from _check_numbers(variable, root)
    yield from _check_names(variables)
    yield from _check_references(variables)
    yield from _check_structure(root, variables)


def interfaces(description: Any) -> list[Any]:
    """The elements CoSimulation and ModelExchange of the description, as far as present."""
    return [element for element in (description.coSimulation, description.modelExchange) if element is not None]


def _check_root(root: Element) -> Iterator[Finding]:
    """Check GUID, interfaces, date and unique names."""
    if not root.get("guid"):
        yield Finding(
            "guid",
            "the attribute guid is empty",
            "it ties description and binary together: generate one",
            section="2.2.1",
        )
    # interfaces: valid C identifiers, consistent capability flags
    elements = [element for kind in ("CoSimulation", "ModelExchange") for element in root.findall(kind)]
    if not elements:
        yield _broken("there is neither a CoSimulation nor a ModelExchange element")
    for element in elements:
        section = "4.3.1" if element.tag == "CoSimulation" else "3.3.1"
        identifier = element.get("modelIdentifier", "")
        if not _IDENTIFIER.fullmatch(identifier) or keyword.iskeyword(identifier):
            message = f'the modelIdentifier "{identifier}" is no name of the language C'
            yield Finding("model description", message, "use letters, digits and _", section=section)
        if element.get("canSerializeFMUstate") == "true" and element.get("canGetAndSetFMUstate") != "true":
            message = f"{element.tag} has canSerializeFMUstate without canGetAndSetFMUstate"
            yield Finding("model description", message, "claim both, or none", Severity.WARNING, section=section)
    # names that must be unique
    for path in (
        "UnitDefinitions/Unit",
        "TypeDefinitions/SimpleType",
        "LogCategories/Category",
        "VendorAnnotations/Tool",
    ):
        for name, count in Counter(element.get("name", "") for element in root.iterfind(path)).items():
            if count > 1:
                yield _broken(f'{path} "{name}" is there {count} times', Severity.WARNING)
    date = root.get("generationDateAndTime")
    if date is not None:
        try:
            datetime.fromisoformat(date)
        except ValueError:
            yield _broken(f'generationDateAndTime "{date}" is no date like 2026-01-31T12:00:00Z', Severity.WARNING)


def _check_experiment(root: Element) -> Iterator[Finding]:
    """Check that the default experiment can be run."""
    experiment = root.find("DefaultExperiment")
    if experiment is None:
        return
    numbers = {name: _number(experiment.get(name), None) for name in ("startTime", "stopTime", "stepSize", "tolerance")}
    start, stop, step = numbers["startTime"] or 0.0, numbers["stopTime"], numbers["stepSize"]
    # finite, in order, above zero
    problems = [
        f"{name} is {value}" for name, value in numbers.items() if value is not None and not math.isfinite(value)
    ]
    if stop is not None and not stop > start:
        problems.append(f"stopTime {stop:g} s is not after startTime {start:g} s")
    above = {name: numbers[name] for name in ("stepSize", "tolerance") if numbers[name] is not None}
    problems += [f"{name} is {value:g}, not above 0" for name, value in above.items() if not value > 0.0]
    if stop is not None and step is not None and step > (stop - start) * (1.0 + 1e-9) > 0.0:
        problems.append(f"stepSize {step:g} s is longer than the whole experiment of {stop - start:g} s")
    for message in problems:
        yield Finding("experiment", message, "correct DefaultExperiment: tools run it as it is")


def _check_numbers(variable: Element, root: Element) -> Iterator[Finding]:
    """Check range, start and nominal of a variable, including attributes of its declared type."""
    name, kind = variable.get("name", ""), next((child for child in variable if child.tag != "Annotations"), None)
    if variable.get("causality") in ("input", "independent") and variable.get("initial") is not None:
        message = f"{name} has initial although it is an {variable.get('causality')}"
        yield Finding("start value", message, "leave initial out", subject=name)
    if kind is None:
        return
    # declared type
    declared = _declared_type(kind, root)
    if kind.get("declaredType") and declared is None:
        message = f'{name} has the type "{kind.get("declaredType")}", which is not defined as {kind.tag}'
        yield Finding("model description", message, "define it in TypeDefinitions", subject=name, section="2.2.3")
    if kind.tag not in _NUMBERS:
        return
    # bounds: those of the variable override those of its type
    text = {
        key: kind.get(key, declared.get(key) if declared is not None else None) for key in ("min", "max", "nominal")
    }
    low, high = _number(text["min"], -math.inf), _number(text["max"], math.inf)
    start = _number(kind.get("start"), None)
    if low > high:
        yield Finding("range", f"{name} has min {low:g} above max {high:g}", "exchange them", subject=name)
    # the start value lies within the bounds
    if start is not None and not math.isfinite(start):
        yield Finding("start value", f"{name} starts at {start}", "give a finite start value", subject=name)
    elif start is not None and not low <= start <= high:
        message = f"{name} starts at {start}, outside {low} to {high}"
        yield Finding("start value", message, "correct start, min or max", subject=name)
    # items of an enumeration
    values = [_number(item.get("value"), None) for item in declared.iterfind("Item")] if declared is not None else []
    items = [int(value) for value in values if value is not None and math.isfinite(value)]
    if kind.tag == "Enumeration" and start is not None and items and start not in items:
        message = f"{name} starts at {start:g}, its type has {', '.join(map(str, items))}"
        yield Finding("start value", message, "start with one of the items", subject=name)
    if len(set(items)) < len(items):
        message = f"the type of {name} has items with the same value"
        yield Finding("model description", message, "give each its own", subject=name, section="2.2.3")
    if not _number(text["nominal"], 1.0) > 0.0:
        message = f"{name} has nominal {text['nominal']}"
        yield Finding("nominal", message, "give its order of magnitude, above 0", Severity.WARNING, name)


def _check_names(variables: list[Element]) -> Iterator[Finding]:
    """Check that no name is empty and at most one variable is independent."""
    for number, variable in enumerate(variables, 1):
        if not variable.get("name", "").strip():
            message = f"variable {number} has an empty name"
            yield Finding("model description", message, "give each a name", section="2.2.7")
    times = [variable.get("name", "") for variable in variables if variable.get("causality") == "independent"]
    if len(times) > 1:
        message = f'{" and ".join(times[:3])} all have causality="independent"'
        yield Finding("model description", message, "leave one: the time", subject=times[0], section="2.2.7")


def _declared_type(kind: Element, root: Element) -> Element | None:
    """Definition of a variable's declared type; None if missing or of another base type."""
    name = kind.get("declaredType")
    types = (each for each in root.iterfind("TypeDefinitions/SimpleType") if name and each.get("name") == name)
    return next((child for each in types for child in each if child.tag == kind.tag), None)


def _check_references(variables: list[Element]) -> Iterator[Finding]:
    """Check aliases: variables of one base type with the same value reference."""
    # groups of aliases
    aliases: dict[tuple[str, str], list[tuple[Element, Element]]] = {}
    for variable in variables:
        for kind in variable:
            base = "Integer" if kind.tag == "Enumeration" else kind.tag
            if base != "Annotations":
                aliases.setdefault((base, variable.get("valueReference", "")), []).append((variable, kind))
    for (_, reference), group in aliases.items():
        if len(group) < 2:
            continue
        # the first contradiction within the group
        names = " and ".join(variable.get("name", "") for variable, _ in group[:3])
        settable = [variable for variable, _ in group if variable.get("causality") in _SETTABLE]
        constant = [variable for variable, _ in group if variable.get("variability") == "constant"]
        problem = ""
        if len(settable) > 1:
            names = " and ".join(variable.get("name", "") for variable in settable[:3])
            problem = "can be set independently"
        elif constant and len(constant) < len(group):
            problem = "are constant and not constant"
        elif len({kind.get("unit") for _, kind in group if kind.get("unit")}) > 1:
            problem = "have different units"
        if problem:
            message = f"{names} share the value reference {reference} but {problem}"
            yield Finding("value reference", message, "give each its own, or make them aliases", subject=names)


def _check_structure(root: Element, variables: list[Element]) -> Iterator[Finding]:
    """Check the indices in the model structure and of derivatives."""
    # indices of the model structure: unique, and of existing variables
    for part in ("Outputs", "Derivatives", "InitialUnknowns"):
        unknowns = root.findall(f"ModelStructure/{part}/Unknown")
        for index, count in Counter(unknown.get("index", "") for unknown in unknowns).items():
            if count > 1:
                yield _structure(f"{part} lists the index {index} {count} times", "list it once")
        for unknown in unknowns:
            for index in [unknown.get("index", ""), *(unknown.get("dependencies") or "").split()]:
                if not index.isdigit() or not 1 <= int(index) <= len(variables):
                    yield _structure(f"{part} refers to variable {index} of {len(variables)}", "count from 1")
    # derivatives: each of another continuous Real, one per state
    states: dict[str, Element] = {}
    derived = {kind.get("derivative") for variable in variables for kind in variable if kind.tag == "Real"}
    listed = {unknown.get("index") for unknown in root.iterfind("ModelStructure/Derivatives/Unknown")}
    for number, variable in enumerate(variables, 1):
        real = next((kind for kind in variable if kind.tag == "Real"), None)
        of = real.get("derivative") if real is not None else None
        if real is not None and real.get("reinit") == "true" and str(number) not in derived:
            name = variable.get("name", "")
            message = f'{name} has reinit="true" but is no continuous-time state'
            yield Finding("model description", message, "leave reinit out", subject=name, section="2.2.7")
        if of is None:
            continue
        name = variable.get("name", "")
        state = variables[int(of) - 1] if of.isdigit() and 1 <= int(of) <= len(variables) else None
        if state is None or int(of) == number or state.find("Real") is None:
            message = f"{name} is the derivative of variable {of}, which is no other Real"
            yield _structure(message, "give the index of the state, from 1", name)
        elif state.get("variability", "continuous") != "continuous":
            yield _structure(
                f"{name} is the derivative of {state.get('name')}, which is not continuous", "correct it", name
            )
        elif of in states and str(number) in listed:
            other = states[of].get("name", "")
            yield _structure(f"{name} and {other} are derivatives of the same state", "list one of them", name)
        elif str(number) in listed:
            states[of] = variable


def _structure(message: str, remedy: str, subject: str = "") -> Finding:
    return Finding("model description", message, remedy, subject=subject, section="2.2.8")


def _number(text: str | None, default: Any) -> Any:
    if text is None:
        return default
    try:
        return float(text)
    except ValueError:  # fmpy's rules report it
        return default


def _broken(problem: str, severity: Severity = Severity.ERROR) -> Finding:
    quoted = re.search(r'"([^"]+)"', problem)
    subject = quoted[1] if quoted else ""
    return Finding("model description", " ".join(problem.split()), "correct modelDescription.xml", severity, subject)


Exponents = dict[str, int]

BASE = ("kg", "m", "s", "A", "K", "mol", "cd")
"""Base units whose exponents are checked; rad is not, since an angle may also have the unit 1."""

_SYMBOLS: dict[str, tuple[float, Exponents]] = {
    **{
        symbol: (1.0, {b: e for b, e in units.items() if b != "rad"})
        for symbol, units in COHERENT.items()
        if symbol not in ("kg", "Hz")
    },
    "g": (1e-3, {"kg": 1}),
    "mol": (1.0, {"mol": 1}),
    "cd": (1.0, {"cd": 1}),
    "V": (1.0, {"kg": 1, "m": 2, "s": -3, "A": -1}),
    "Ohm": (1.0, {"kg": 1, "m": 2, "s": -3, "A": -2}),
    "S": (1.0, {"kg": -1, "m": -2, "s": 3, "A": 2}),
    "F": (1.0, {"kg": -1, "m": -2, "s": 4, "A": 2}),
    "H": (1.0, {"kg": 1, "m": 2, "s": -2, "A": -2}),
    "Wb": (1.0, {"kg": 1, "m": 2, "s": -2, "A": -1}),
    "T": (1.0, {"kg": 1, "s": -2, "A": -1}),
    "bar": (1e5, {"kg": 1, "m": -1, "s": -2}),
}
"""Symbols that may have a prefix → factor and exponents."""

_PLAIN: dict[str, tuple[float, Exponents]] = {
    "Hz": (math.nan, {"s": -1}),  # with or without 2 pi: both are in use
    "deg": (math.pi / 180.0, {}),
    "min": (60.0, {"s": 1}),
    "h": (3600.0, {"s": 1}),
    "d": (86400.0, {"s": 1}),
    "degC": (1.0, {"K": 1}),
}
"""Symbols without prefixes → factor and exponents."""

_PREFIXES = {"n": 1e-9, "u": 1e-6, "m": 1e-3, "c": 1e-2, "d": 1e-1, "k": 1e3, "M": 1e6, "G": 1e9}
_FACTOR = re.compile(r"(?P<symbol>1|[A-Za-z]+)\^?(?P<power>-?\d+)?")
_QUOTIENT = re.compile(r"(?P<above>[^/()]+)(/\((?P<product>[^/()]+)\)|(?P<factors>(/[^/().*]+)*))")
"""a.b, a/b, a/b/c and a/(b.c), but not a/b.c, which is ambiguous."""

_CLOSE = 1e-3


Meaning = tuple[float, Exponents]
"""Factor to SI units, NaN if ambiguous, and exponents of the base units."""


def meaning(name: str) -> Meaning | None:
    """Factor and exponents that the name of a unit implies; None if the name is unknown or ambiguous."""
    factor, exponents = 1.0, dict.fromkeys(BASE, 0)
    form = _QUOTIENT.fullmatch(name.replace(" ", ""))
    if form is None:
        return None
    # factors of the numerator, then of the denominator
    below = [form["product"]] if form["product"] else form["factors"].split("/")[1:]
    for sign, product in ((1, form["above"]), *((-1, part) for part in below)):
        for part in re.split(r"[.*]", product):
            match = _FACTOR.fullmatch(part)
            if match is None or (known := _symbol(match["symbol"])) is None:
                return None
            power = sign * int(match["power"] or 1)
            factor *= known[0] ** power
            for base, exponent in known[1].items():
                exponents[base] += power * exponent
    return factor, exponents


def _symbol(text: str) -> tuple[float, Exponents] | None:
    for table in (_PLAIN, _SYMBOLS):
        if text in table:
            return table[text]
    prefix, rest = _PREFIXES.get(text[:1]), _SYMBOLS.get(text[1:])
    return (prefix * rest[0], rest[1]) if prefix and rest and text[1:] not in ("1", "rad") else None


def check_units(root: Element) -> Iterator[Finding]:
    """Yield findings about exponents, factors and display units.

    Raises:
        ValueError: an exponent or factor is not a number.

    Args:
        root: the element fmiModelDescription.
    """
    for unit in root.iterfind("UnitDefinitions/Unit"):
        name, base, known = unit.get("name", ""), unit.find("BaseUnit"), meaning(unit.get("name", ""))
        if known is not None and base is not None:
            # exponents of the base units
            given = {each: int(base.get(each, "0")) for each in BASE}
            if wrong := [each for each in BASE if given[each] != known[1][each]]:
                shown, right = (" ".join(f"{each}={of[each]}" for each in wrong) for of in (given, known[1]))
                yield Finding("units", f"{name} is defined with {shown}", f"a {name} has {right}", subject=name)
                continue
            # factor to SI units
            factor = float(base.get("factor", "1"))
            if not math.isnan(known[0]) and abs(factor - known[0]) > _CLOSE * known[0]:
                message = f"{name} is defined with the factor {factor:g}"
                yield Finding("units", message, f"a {name} has {known[0]:g}", subject=name)
        # display units
        for display in unit.iterfind("DisplayUnit"):
            name, factor = display.get("name", ""), float(display.get("factor", "1"))
            shown_as = meaning(name)
            if factor == 0.0:
                message, remedy = f"the display unit {name} has the factor 0", "give value = factor * unit + offset"
                yield Finding("units", message, remedy, subject=name)
            elif shown_as and known and shown_as[1] == known[1] and shown_as[0] > 0.0:
                ratio = known[0] / shown_as[0]
                if abs(factor - ratio) > _CLOSE * ratio:
                    message = f"the display unit {name} of {unit.get('name')} has the factor {factor:g}"
                    yield Finding("units", message, f"it is {ratio:g}: value = factor * unit + offset", subject=name)
