"""Checks of modelDescription.xml.

Unit definitions (SI exponents, factors) must match the names of the units; ambiguous names, such as a/b.c, are not checked.
"""

from __future__ import annotations

import keyword
import math
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from datetime import datetime
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from fmpy.model_description import read_model_description
from fmpy.validation import validate_fmu as validate_by_fmpy

from flexfmu.fmu_build.units import BASE_UNITS, meaning
from flexfmu.fmu_build.validation.finding import Finding, Severity, named

_NUMBERS = {"Real", "Integer", "Enumeration"}
_SETTABLE = {"input", "parameter"}
_IDENTIFIER = re.compile(r"[A-Za-z_]\w*", re.ASCII)
_FMPY_ERRORS = {"list index out of range", "'NoneType' object has no attribute 'get'"}
"""Messages of Python exceptions that fmpy reports as problems of the description."""

_ENCODING = re.compile(rb"""<\?xml[^>]*encoding\s*=\s*["']([^"']+)""")


def fmi_version(content: bytes) -> str:
    """The attribute fmiVersion of a modelDescription.xml; empty if it is missing."""
    match = re.search(rb"""<fmiModelDescription[^>]*?\sfmiVersion\s*=\s*["']([^"']*)""", content, re.DOTALL)
    return match.group(1).decode(errors="replace") if match else ""


def read_description(path: Path, content: bytes) -> tuple[Any | None, list[Finding]]:
    """The description as read by fmpy, None if fmpy can't read it; and the findings of fmpy's rules and, for FMI 2.0, of further ones.

    Args:
        path: the FMU.
        content: bytes of its modelDescription.xml.
    """
    problems = [problem for problem in validate_by_fmpy(str(path)) if "contains a backslash" not in problem]
    further = list(named("model description", _check(content))) if fmi_version(content) == "2.0" else []
    # where fmpy crashes, a further rule usually finds the cause; otherwise its message remains
    findings = [_broken(problem) for problem in problems if problem not in _FMPY_ERRORS]
    crashes = [problem for problem in problems if problem in _FMPY_ERRORS]
    if crashes and not any(finding.severity is Severity.ERROR for finding in further):
        findings.append(_broken(f"fmpy cannot read modelDescription.xml: {crashes[0]}"))
    try:
        description = read_model_description(str(path), validate=False)
    except Exception as error:  # fmpy and lxml raise many types for a broken description
        description, findings = None, findings if problems else [_broken(str(error))]
    return description, [*findings, *further]


def _check(content: bytes) -> Iterator[Finding]:
    """Yield findings that fmpy's rules don't cover."""
    # encoding and document type
    encoding = _ENCODING.match(content)
    if encoding and encoding[1].lower() not in (b"utf-8", b"utf8", b"us-ascii"):
        message = f"modelDescription.xml is encoded as {encoding[1].decode(errors='replace')}"
        yield Finding(message, "use UTF-8", Severity.WARNING)
    if b"<!DOCTYPE" in content:
        message = "modelDescription.xml has a document type (<!DOCTYPE ...>), which tools refuse for safety"
        yield Finding(message, "leave it out", Severity.WARNING)
    try:
        root = ElementTree.fromstring(content)
    except (ElementTree.ParseError, LookupError, ValueError):  # fmpy's rules report it
        return
    # attributes, default experiment, units
    yield from _check_root(root)
    yield from named("experiment", _check_experiment(root))
    try:
        yield from named("units", _check_units(root))
    except ValueError as error:  # not a number
        yield Finding(" ".join(str(error).split()), "give numbers", check="units")
    # each variable alone, then all of them together
    variables = root.findall("ModelVariables/ScalarVariable")
    definitions = root.iterfind("TypeDefinitions/SimpleType")
    types = {(each.get("name", ""), kind.tag): kind for each in definitions for kind in each}
    for variable in variables:
        yield from _check_variable(variable, types)
    times = [variable.get("name", "") for variable in variables if variable.get("causality") == "independent"]
    if len(times) > 1:
        message = f'{" and ".join(times[:3])} all have causality="independent"'
        yield Finding(message, "leave one: the time", subject=times[0], section="2.2.7")
    yield from named("value reference", _check_references(variables))
    yield from _check_structure(root, variables)


def interfaces(description: Any) -> list[Any]:
    """The elements CoSimulation and ModelExchange of the description, as far as present."""
    return [element for element in (description.coSimulation, description.modelExchange) if element is not None]


def _check_root(root: Element) -> Iterator[Finding]:
    """Check GUID, interfaces, date and unique names."""
    if not root.get("guid"):
        remedy = "it ties description and binary together: generate one"
        yield Finding("the attribute guid is empty", remedy, check="guid", section="2.2.1")
    # interfaces: valid C identifiers, consistent capability flags
    elements = [element for kind in ("CoSimulation", "ModelExchange") for element in root.findall(kind)]
    if not elements:
        yield _broken("there is neither a CoSimulation nor a ModelExchange element")
    for element in elements:
        section = "4.3.1" if element.tag == "CoSimulation" else "3.3.1"
        identifier = element.get("modelIdentifier", "")
        if not _IDENTIFIER.fullmatch(identifier) or keyword.iskeyword(identifier):
            message = f'the modelIdentifier "{identifier}" is no name of the language C'
            yield Finding(message, "use letters, digits and _", section=section)
        if element.get("canSerializeFMUstate") == "true" and element.get("canGetAndSetFMUstate") != "true":
            message = f"{element.tag} has canSerializeFMUstate without canGetAndSetFMUstate"
            yield Finding(message, "claim both, or none", Severity.WARNING, section=section)
    # names that must be unique
    for path in [
        "UnitDefinitions/Unit",
        "TypeDefinitions/SimpleType",
        "LogCategories/Category",
        "VendorAnnotations/Tool",
    ]:
        for name, count in Counter(element.get("name", "") for element in root.iterfind(path)).items():
            if count > 1:
                yield _broken(f'{path} "{name}" is there {count} times', Severity.WARNING)
    date = root.get("generationDateAndTime", "2026-01-31T12:00:00Z")
    try:
        datetime.fromisoformat(date)
    except ValueError:
        yield _broken(f'generationDateAndTime "{date}" is no date like 2026-01-31T12:00:00Z', Severity.WARNING)


def _check_experiment(root: Element) -> Iterator[Finding]:
    """Check that the default experiment can be run."""
    experiment = root.find("DefaultExperiment")
    if experiment is None:
        return
    keys = ("startTime", "stopTime", "stepSize", "tolerance")
    given = {key: _number(experiment.get(key), 0.0) for key in keys if experiment.get(key) is not None}
    start, stop, step = given.get("startTime", 0.0), given.get("stopTime"), given.get("stepSize", 0.0)
    # finite, above zero, in order
    problems = [f"{key} is {value}" for key, value in given.items() if not math.isfinite(value)]
    problems += [f"{key} is {given[key]:g}, not above 0" for key in keys[2:] if not given.get(key, 1.0) > 0.0]
    if stop is not None and not stop > start:
        problems.append(f"stopTime {stop:g} s is not after startTime {start:g} s")
    if stop is not None and step > (stop - start) * (1.0 + 1e-9) > 0.0:
        problems.append(f"stepSize {step:g} s is longer than the whole experiment of {stop - start:g} s")
    for message in problems:
        yield Finding(message, "correct DefaultExperiment: tools run it as it is")


def _check_variable(variable: Element, types: Mapping[tuple[str, str], Element]) -> Iterator[Finding]:
    """Check name, range, start and nominal of a variable, including attributes of its declared type."""
    name, kind = variable.get("name", ""), next((child for child in variable if child.tag != "Annotations"), None)
    if not name.strip():
        message = f"the variable of the value reference {variable.get('valueReference')} has an empty name"
        yield Finding(message, "give each a name", section="2.2.7")
    if variable.get("causality") in ("input", "independent") and variable.get("initial") is not None:
        message = f"{name} has initial although it is an {variable.get('causality')}"
        yield Finding(message, "leave initial out", subject=name, check="start value")
    if kind is None:
        return
    # declared type, of the same base type
    declared = types.get((kind.get("declaredType", ""), kind.tag))
    if kind.get("declaredType") and declared is None:
        message = f'{name} has the type "{kind.get("declaredType")}", which is not defined as {kind.tag}'
        yield Finding(message, "define it in TypeDefinitions", subject=name, section="2.2.3")
    if kind.tag not in _NUMBERS:
        return
    # bounds: those of the variable override those of its type
    attributes = (declared.attrib if declared is not None else {}) | kind.attrib
    low, high = _number(attributes.get("min"), -math.inf), _number(attributes.get("max"), math.inf)
    start = _number(kind.get("start"), None)
    if low > high:
        yield Finding(f"{name} has min {low:g} above max {high:g}", "exchange them", subject=name, check="range")
    # the start value lies within the bounds, and is an item of an enumeration
    values = (
        [_number(item.get("value"), math.nan) for item in declared.iterfind("Item")] if declared is not None else []
    )
    items = [int(value) for value in values if math.isfinite(value)]
    problem = remedy = ""
    if start is not None and not math.isfinite(start):
        problem, remedy = f"starts at {start}", "give a finite start value"
    elif start is not None and not low <= start <= high:
        problem, remedy = f"starts at {start}, outside {low} to {high}", "correct start, min or max"
    elif start is not None and kind.tag == "Enumeration" and items and start not in items:
        problem, remedy = (
            f"starts at {start:g}, its type has {', '.join(map(str, items))}",
            "start with one of the items",
        )
    if problem:
        yield Finding(f"{name} {problem}", remedy, subject=name, check="start value")
    if len(set(items)) < len(items):
        message = f"the type of {name} has items with the same value"
        yield Finding(message, "give each its own", subject=name, section="2.2.3")
    if not _number(attributes.get("nominal"), 1.0) > 0.0:
        message, remedy = f"{name} has nominal {attributes['nominal']}", "give its order of magnitude, above 0"
        yield Finding(message, remedy, Severity.WARNING, name, check="nominal")


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
            yield Finding(message, "give each its own, or make them aliases", subject=names)


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
                if not index.isdecimal() or len(index) > 9 or not 1 <= int(index) <= len(variables):
                    yield _structure(f"{part} refers to variable {index[:80]} of {len(variables)}", "count from 1")
    # derivatives: each of another continuous Real, one per state
    states: dict[str, Element] = {}
    derived = {real.get("derivative") for real in root.iterfind("ModelVariables/ScalarVariable/Real")}
    listed = {unknown.get("index") for unknown in root.iterfind("ModelStructure/Derivatives/Unknown")}
    for number, variable in enumerate(variables, 1):
        name, real = variable.get("name", ""), variable.find("Real")
        if real is None:
            continue
        if real.get("reinit") == "true" and str(number) not in derived:
            message = f'{name} has reinit="true" but is no continuous-time state'
            yield Finding(message, "leave reinit out", subject=name, section="2.2.7")
        of = real.get("derivative")
        if of is None:
            continue
        state = variables[int(of) - 1] if of.isdecimal() and len(of) < 10 and 1 <= int(of) <= len(variables) else None
        if state is None or int(of) == number or state.find("Real") is None:
            message = f"{name} is the derivative of variable {of}, which is no other Real"
            yield _structure(message, "give the index of the state, from 1", name)
        elif state.get("variability", "continuous") != "continuous":
            message = f"{name} is the derivative of {state.get('name')}, which is not continuous"
            yield _structure(message, "correct it", name)
        elif of in states and str(number) in listed:
            other = states[of].get("name", "")
            yield _structure(f"{name} and {other} are derivatives of the same state", "list one of them", name)
        elif str(number) in listed:
            states[of] = variable


def _structure(message: str, remedy: str, subject: str = "") -> Finding:
    return Finding(message, remedy, subject=subject, section="2.2.8")


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
    return Finding(" ".join(problem.split()), "correct modelDescription.xml", severity, subject, "model description")


_CHECKED = BASE_UNITS[:-1]
"""Base units whose exponents are checked; rad is not, since an angle may also have the unit 1."""

_CLOSE = 1e-3


def _check_units(root: Element) -> Iterator[Finding]:
    """Check exponents, factors and display units against the names of the units; ValueError if one is not a number."""
    for unit in root.iterfind("UnitDefinitions/Unit"):
        name, base, known = unit.get("name", ""), unit.find("BaseUnit"), meaning(unit.get("name", ""))
        if known is not None and base is not None:
            # exponents of the base units
            given = {each: int(base.get(each, "0")) for each in _CHECKED}
            if wrong := [each for each in _CHECKED if given[each] != known[1][each]]:
                shown, right = (" ".join(f"{each}={of[each]}" for each in wrong) for of in (given, known[1]))
                yield Finding(f"{name} is defined with {shown}", f"a {name} has {right}", subject=name)
                continue
            # factor to SI units
            factor = float(base.get("factor", "1"))
            if abs(factor - known[0]) > _CLOSE * known[0]:
                message = f"{name} is defined with the factor {factor:g}"
                yield Finding(message, f"a {name} has {known[0]:g}", subject=name)
        # display units
        for display in unit.iterfind("DisplayUnit"):
            name, factor = display.get("name", ""), float(display.get("factor", "1"))
            shown_as = meaning(name)
            if factor == 0.0:
                message = f"the display unit {name} has the factor 0"
                yield Finding(message, "give value = factor * unit + offset", subject=name)
            elif shown_as and known and shown_as[1] == known[1] and shown_as[0] > 0.0:
                ratio = known[0] / shown_as[0]
                if abs(factor - ratio) > _CLOSE * ratio:
                    message = f"the display unit {name} of {unit.get('name')} has the factor {factor:g}"
                    yield Finding(message, f"it is {ratio:g}: value = factor * unit + offset", subject=name)
