"""What an SSP file of others means: units, transformations, parameter sets, against the closed form of two FMUs in a row."""

from __future__ import annotations

from collections.abc import Callable
from math import exp
from pathlib import Path

import pytest
from ssp_support.packages import (
    CONNECTION,
    NAMESPACES,
    SSD,
    binding,
    connected,
    inline,
    of_second,
    of_system,
    parameter_set,
)

from flexfmu.cosim.engine.master.simulator import Outcome
from flexfmu.cosim.engine.master.system import LinearMap
from flexfmu.cosim.exchange.ssp.archive import SspError
from flexfmu.cosim.exchange.ssp.loading import load_ssp
from flexfmu.cosim.exchange.ssp.structure import SspUnit, ValueMap

MakeSsp = Callable[..., Path]
STEP, COUNT = 0.125, 8


def closed_form(factor: float = 1.0, offset: float = 0.0, rate: float = 1.0, start: float = 1.0) -> float:
    """x2 at the end: x1 decays to zero; x2 follows factor x1 + offset, held over each step."""
    first, second = 1.0, start
    for _ in range(COUNT):
        fed = factor * first + offset
        second = fed + (second - fed) * exp(-rate * STEP)
        first *= exp(-STEP)
    return second


def nested(outer: str = "", within: str = "", into: str = "", out: str = "", bindings: str = "") -> str:
    """The second FMU in a system ``inner`` of its own, whose connectors u (in mm), y and rate lead to it; the whole system
    shows ``result`` and has the parameter ``speed``. Arguments: bindings of the whole and of ``inner``, transformations on
    the way in and on the way out, bindings of the component."""
    head, rest = SSD.split('<ssd:Component name="second"')
    second, tail = rest.split("</ssd:Component>")
    second = second.replace(
        "</ssd:Connectors>", f'<ssd:Connector name="rate" kind="parameter"/></ssd:Connectors>{bindings}'
    )
    inner = f"""<ssd:System name="inner"><ssd:Connectors>
      <ssd:Connector name="u" kind="input"><ssc:Real unit="mm"/></ssd:Connector>
      <ssd:Connector name="y" kind="output"/><ssd:Connector name="rate" kind="parameter"/></ssd:Connectors>{within}
      <ssd:Elements><ssd:Component name="second"{second}</ssd:Component></ssd:Elements><ssd:Connections>
      <ssd:Connection startElement="" startConnector="u" endElement="second" endConnector="u">{into}</ssd:Connection>
      <ssd:Connection startConnector="rate" endElement="second" endConnector="rate"/>
      <ssd:Connection startElement="second" startConnector="x" endConnector="y"/></ssd:Connections></ssd:System>"""
    connections = f"""<ssd:Connection startElement="first" startConnector="x" endElement="inner" endConnector="u"/>
      <ssd:Connection startConnector="speed" endElement="inner" endConnector="rate"><ssc:LinearTransformation factor="2"/></ssd:Connection>
      <ssd:Connection startElement="inner" startConnector="y" endConnector="result">{out}</ssd:Connection>"""
    shown = '<ssd:Connectors><ssd:Connector name="result" kind="output"/><ssd:Connector name="speed" kind="parameter"/></ssd:Connectors>'
    ssd = f"{head.replace('<ssd:Elements>', f'{shown}{outer}<ssd:Elements>')}{inner}{tail}"
    return ssd.replace(CONNECTION, connections)


def linear(factor: float, offset: float = 0.0) -> str:
    """target = factor * source + offset."""
    return f'<ssc:LinearTransformation factor="{factor}" offset="{offset}"/>'


def table(kind: str, **pairs: object) -> str:
    """A table of values; names begin with a letter: ``_3=5``."""
    entries = "".join(f'<ssc:MapEntry source="{a.lstrip("_")}" target="{b}"/>' for a, b in pairs.items())
    return f"<ssc:{kind}MappingTransformation>{entries}</ssc:{kind}MappingTransformation>"


def mapping(*entries: tuple[str, str, str]) -> str:
    """A parameter mapping of (source, target, transformation)."""
    inner = "".join(f'<ssm:MappingEntry source="{a}" target="{b}">{how}</ssm:MappingEntry>' for a, b, how in entries)
    return f'<ssm:ParameterMapping {NAMESPACES} version="1.0">{inner}</ssm:ParameterMapping>'


def mapped(*entries: tuple[str, str, str]) -> str:
    """The same within a binding."""
    return f'<ssd:ParameterMapping source="">{mapping(*entries)}</ssd:ParameterMapping>'


def given(**values: float) -> str:
    """An inline parameter set of real values."""
    return inline(parameter_set(**{name: f'Real value="{value}"' for name, value in values.items()}))


SET = parameter_set(
    rate='Real value="2.5"', x='Integer value="4"', label='String value="tired"', nobody='Real value="1"'
)
SPEED = parameter_set(speed='Real value="2"', x='Real value="9"')
OF_SPEED = ("speed", "rate", linear(3, -1))
MILLIMETRES = parameter_set(x='Real value="2000" unit="mm"').replace(
    "</ssv:Parameters>",
    '</ssv:Parameters><ssv:Units><ssc:Unit name="mm"><ssc:BaseUnit m="1" factor="0.001"/></ssc:Unit></ssv:Units>',
)
SMALL = SSD.replace('name="second" source="resources/decay.fmu"', 'name="second" source="resources/small.fmu"')
"""The second FMU's variables are in millimetres."""

OUTSIDE = """<ssd:Connection startConnector="reference" endElement="second" endConnector="u"/>
  <ssd:Connection startElement="second" startConnector="x" endConnector="result"/>"""
OUTER = '<ssd:Connectors><ssd:Connector name="reference" kind="input"/><ssd:Connector name="result" kind="output"/></ssd:Connectors>'
TWICE = of_second((given(rate=2) + given(rate=3)).replace("</ssd:ParameterBindings><ssd:ParameterBindings>", ""))
SSP_2 = SSD.replace('version="1.0" name', 'version="2.0" name').replace("ssc:Real", "ssc:Float64")
FLAG, MOOD = table("Boolean", false="true"), table("Enumeration", fine="none")
NAMED = parameter_set(flag='Boolean value="false"', mood='Enumeration value="fine"')

MEANING: dict[str, tuple[str, dict[str, float]]] = {
    "as it is": (SSD, {}),
    "start and end say nothing about the direction": (
        connected(startElement="second", startConnector="u", endElement="first", endConnector="x"),
        {},
    ),
    "linear transformation": (connected(linear(-3, 0.5)), {"factor": -3.0, "offset": 0.5}),
    "units": (SMALL, {"factor": 1e3}),
    "units, suppressed": (connected("", 'suppressUnitConversion="true"', SMALL), {}),
    "units before the transformation": (connected(linear(2, 0.5), "", SMALL), {"factor": 2e3, "offset": 0.5}),
    "units, suppressed, and a transformation": (
        connected(linear(2), 'suppressUnitConversion="true"', SMALL),
        {"factor": 2.0},
    ),
    "set at the component": (of_second(inline(SET)), {"rate": 2.5, "start": 4.0}),
    "set in a file": (of_second(binding('source="resources/values.ssv"')), {"rate": 2.5, "start": 4.0}),
    "set with a prefix": (of_system(inline(SET, 'prefix="second."')), {"rate": 2.5, "start": 4.0}),
    "set with hierarchical names": (
        of_system(inline(SET.replace('name="', 'name="second.'), 'type="application/x-ssp-parameter-set"')),
        {"rate": 2.5, "start": 4.0},
    ),
    "later sets outrank earlier ones": (TWICE, {"rate": 3.0}),
    "the system outranks its components": (of_system(given(second__rate=4), TWICE), {"rate": 4.0}),
    "mapping": (of_second(inline(SPEED, mapping=mapped(OF_SPEED))), {"rate": 5.0}),
    "mapping in a file": (
        of_second(inline(SPEED, mapping='<ssd:ParameterMapping source="resources/map.ssm"/>')),
        {"rate": 5.0},
    ),
    "unit of a value": (of_second(inline(MILLIMETRES)), {"start": 2.0}),
    "unit of a value before its transformation": (
        of_second(inline(MILLIMETRES, mapping=mapped(("x", "x", linear(3, -1))))),
        {"start": 5.0},
    ),
    "the system's own connectors": (
        of_system(OUTER + given(reference=0.25), SSD.replace(CONNECTION, OUTSIDE)),
        {"factor": 0.0, "offset": 0.25},
    ),
    "tables of parameters": (
        of_second(inline(NAMED, mapping=mapped(("flag", "inverted", FLAG), ("mood", "trouble", MOOD)))),
        {"factor": -1.0},
    ),
    "SSP 2.0 with types of FMI 3.0": (
        of_second(inline(parameter_set(rate='Float64 value="2"')), SSP_2.replace("ssc:Integer", "ssc:Int32")),
        {"rate": 2.0},
    ),
    "nested": (nested(), {}),
    "nested, of the component": (nested(bindings=given(rate=2)), {"rate": 2.0}),
    "nested, the system outranks": (nested(bindings=given(rate=2), within=given(second__rate=3)), {"rate": 3.0}),
    "nested, prefix": (
        nested(within=inline(parameter_set(rate='Real value="4"'), 'prefix="second." source=""')),
        {"rate": 4.0},
    ),
    "nested, prefix and mapping": (
        nested(
            within=inline(
                parameter_set(b='Real value="5"'),
                'prefix="a."',
                mapped(("a.b", "second.rate", ""), ("", "second.x", "")),
            )
        ),
        {"rate": 5.0},
    ),
    "nested, connector of the system": (nested(within=given(rate=6)), {"rate": 6.0}),
    "nested, from the outside": (
        nested(within=given(second__rate=3), outer=given(inner__second__rate=7)),
        {"rate": 7.0},
    ),
    "nested, connectors outrank names": (nested(within=given(second__rate=3), outer=given(speed=4.5)), {"rate": 9.0}),
}
"""What a file says → its description, and the closed form that follows from the standard."""


@pytest.mark.parametrize("name", MEANING)
def test_closed_form(name: str, make_ssp: MakeSsp, make_decay: Callable[..., Path]) -> None:
    """Connections and parameters do what SSP 1.0 says; what fits no variable is left out, but told."""
    ssd, expected = MEANING[name]
    unit = ('<Unit name="m"><BaseUnit m="1"/></Unit>', '<Unit name="mm"><BaseUnit m="1" factor="0.001"/></Unit>')
    files = {
        "resources/small.fmu": make_decay(unit, ('unit="m"', 'unit="mm"')),
        "resources/values.ssv": SET,
        "resources/map.ssm": mapping(OF_SPEED),
    }
    loaded = load_ssp(make_ssp(ssd, files), step=STEP)
    simulation = loaded.simulate()
    assert simulation.outcome is Outcome.COMPLETED, simulation.message
    recording = simulation.recording
    found = recording["inner.second.x" if name.startswith("nested") else "second.x"].values[-1]
    assert found == pytest.approx(closed_form(**expected), rel=1e-12)
    assert recording["first.x"].values[-1] == pytest.approx(exp(-1.0), rel=1e-12)
    assert recording["first.steps"].values[-1] == COUNT
    unknown = ["nobody"] if name.startswith("set ") else []
    assert [each.rpartition(".")[2] for each in loaded.ignored if "set" not in each] == unknown


def test_units_with_offsets() -> None:
    """Temperatures: 20 °C are 68 °F, 293.15 K and 293150 mK, there and back; a length is no temperature."""
    celsius, kelvin = SspUnit("degC", {"K": 1}, 1.0, 273.15), SspUnit("K", {"K": 1})
    fahrenheit, millikelvin = SspUnit("degF", {"K": 1}, 5.0 / 9.0, 459.67 * 5.0 / 9.0), SspUnit("mK", {"K": 1}, 1e-3)
    for unit, expected in ((fahrenheit, 68.0), (kelvin, 293.15), (millikelvin, 293150.0)):
        there, back = celsius.to(unit), unit.to(celsius)
        assert there is not None
        assert back is not None
        assert there(20.0) == pytest.approx(expected, rel=1e-13)
        assert back(expected) == pytest.approx(20.0, rel=1e-13)
    assert celsius.to(SspUnit("m", {"m": 1})) is None


def test_nested_systems(make_ssp: MakeSsp) -> None:
    """Signals pass through the connectors of systems, converted and transformed on each connection, and are recorded under
    the connectors' names too."""
    loaded = load_ssp(make_ssp(nested(into=linear(2, 3), out=linear(-1, 5))), step=STEP)
    recording = loaded.simulate().recording
    expected = closed_form(2.0, 3.0)  # mm after m: converted into mm and back into m, then transformed
    assert recording["inner.second.x"].values[-1] == pytest.approx(expected, rel=1e-12)
    assert (recording["inner.y"].values == recording["inner.second.x"].values).all()
    assert recording["result"].values[-1] == pytest.approx(5.0 - expected, rel=1e-12)
    assert recording["inner.u"].values[-1] == pytest.approx(1e3 * recording["first.x"].values[-1], rel=1e-12)
    assert (recording["inner.u"].unit, loaded.remarks) == ("mm", ())


def test_tables_that_are_lines() -> None:
    """Two entries always are, more if they lie on one."""
    assert ValueMap(((False, True), (True, False))).linear() == LinearMap(-1.0, 1.0)
    assert ValueMap(((1, 10), (3, 20), (5, 30))).linear() == LinearMap(5.0, 5.0)
    assert ValueMap(((1, 1), (2, 4), (3, 9))).linear() is None


@pytest.mark.parametrize("isolate", [False, None])
def test_tables_that_are_no_lines(make_ssp: MakeSsp, isolate: bool | None) -> None:
    """Integers are looked up at every communication point, through systems' connectors too, which show what comes of it."""
    steps = table("Integer", **{f"_{n}": n * n for n in range(COUNT + 1)})
    recording = (
        load_ssp(make_ssp(connected(steps, startConnector="steps")), step=STEP).simulate(isolate=isolate).recording
    )
    second = 1.0
    for n in range(COUNT):
        second = n * n + (second - n * n) * exp(-STEP)
    assert recording["second.x"].values[-1] == pytest.approx(second, rel=1e-12)
    shown = (
        f'<ssd:Connection startElement="first" startConnector="steps" endConnector="result">{steps}</ssd:Connection>'
    )
    ssd = of_system(OUTER, SSD.replace(CONNECTION, shown))
    recording = load_ssp(make_ssp(ssd), step=STEP).simulate(isolate=isolate).recording
    assert recording["result"].values.tolist() == [n * n for n in range(COUNT + 1)]


def test_values_that_a_table_lacks(make_ssp: MakeSsp) -> None:
    """The run ends where the signal leaves the table, with its value and what the table has."""
    path = make_ssp(connected(table("Integer", _0=7, _1=0, _2=1), startConnector="steps"))
    simulation = load_ssp(path, step=STEP).simulate()
    assert simulation.outcome is Outcome.STEP_FAILED
    problem = "first failed at 0.375 s: the table of a connection has nothing for 3, only for 0, 1, 2"
    assert problem in simulation.message
    assert simulation.recording.time[-1] == pytest.approx(0.25)


def test_tables_of_items(make_ssp: MakeSsp, make_decay: Callable[..., Path]) -> None:
    """Names of items are those of the enumerations at the connection's ends."""
    variables = "".join(
        f'<ScalarVariable name="{name}" valueReference="1" causality="{causality}" variability="discrete"><Enumeration '
        f'declaredType="Trouble"{start}/></ScalarVariable>'
        for name, causality, start in (("mood", "output", ""), ("task", "input", ' start="1"'))
    )
    fmu = {"resources/decay.fmu": make_decay(("</ModelVariables>", f"{variables}</ModelVariables>"))}
    items = table("Enumeration", ends="ends", none="fails")
    ssd = connected(items, startConnector="mood", endConnector="task").replace(
        "<ssc:Integer/>", "<ssc:Enumeration name='Trouble'/>"
    )
    ssd = ssd.replace('name="steps"', 'name="mood"').replace('name="inverted"', 'name="task"')
    simulation = load_ssp(make_ssp(ssd, fmu), step=STEP).simulate()
    assert simulation.recording["second.mood"].values[-1] == 2.0
    assert "second failed at 0.5 s" in simulation.message
    with pytest.raises(SspError, match=r"with the item 'fine', which first\.mood doesn't have; it has: none, fails"):
        load_ssp(make_ssp(ssd.replace('source="none"', 'source="fine"'), fmu), step=STEP)


def test_what_other_tools_write(make_ssp: MakeSsp) -> None:
    """What contradicts the standard or an FMU without harm is passed over and told: connectors that nothing is connected to,
    units that nothing defines, a parameter given twice, model exchange, prefixes that aren't declared."""
    ssd = SSD.replace('name="steps" kind="output"', 'name="_start" kind="parameter"')
    ssd = ssd.replace('name="second" source', 'name="second" implementation="ModelExchange" source')
    first = '<ssv:Parameters><ssv:Parameter name="rate"><ssv:Real value="3"/></ssv:Parameter>'
    values = parameter_set(rate='Real value="2"', x='Real value="4" unit="[m]"').replace("<ssv:Parameters>", first)
    bound = of_second(binding('source="values.ssv"'), ssd)
    loaded = load_ssp(make_ssp(bound, {"values.ssv": values.replace(NAMESPACES, "")}), step=STEP)
    found = loaded.simulate().recording["second.x"].values[-1]
    assert found == pytest.approx(closed_form(rate=2.0, start=4.0), rel=1e-12)
    for fact in ("'_start'", "'[m]' isn't defined", "'rate' twice, 2.0 counts", "is for model exchange"):
        assert [fact in remark for remark in loaded.remarks].count(True) == 1, fact
    assert len(loaded.remarks) == 4


def test_variants(make_ssp: MakeSsp) -> None:
    """A package may hold several systems: the default runs, the others are told and can be asked for, in folders too."""
    slow = of_second(given(rate=0.5))
    path = make_ssp(files={"slow.ssd": slow, "deep/slow.ssd": slow.replace("resources/", "../resources/")})
    told = ("took SystemStructure.ssd; the file also holds deep/slow.ssd, slow.ssd (--ssd)",)
    for options, rate, remarks in (
        ({}, 1.0, told),
        ({"ssd": "slow.ssd"}, 0.5, ()),
        ({"ssd": "deep/slow.ssd"}, 0.5, ()),
    ):
        loaded = load_ssp(path, step=STEP, **options)
        found = loaded.simulate().recording["second.x"].values[-1]
        assert found == pytest.approx(closed_form(rate=rate), rel=1e-12)
        assert not set(remarks) - set(loaded.remarks)


@pytest.mark.parametrize(
    ("annotation", "experiment", "step"),
    [
        ('<o:FixedStepMaster stepSize="0.25"/>', "", 0.25),
        ('<o:SimulationInformation fixedStepSize="0.25"/>', "", 0.25),
        ("", '<DefaultExperiment stopTime="0.5" stepSize="0.125"/>', 0.125),
    ],
    ids=["OMSimulator 2", "OMSimulator 3", "FMUs"],
)
def test_times_where_the_file_says_none(
    annotation: str, experiment: str, step: float, make_ssp: MakeSsp, make_decay: Callable[..., Path]
) -> None:
    """The communication step is in annotations of OMSimulator, or the FMUs' default experiments stand in."""
    note = f'<ssd:Annotations><ssc:Annotation type="org.openmodelica"><o:A xmlns:o="o">{annotation}</o:A></ssc:Annotation></ssd:Annotations>'
    ssd = SSD.replace("</ssd:System>", f"{note}</ssd:System>")
    if experiment:
        ssd = ssd.replace('<ssd:DefaultExperiment startTime="0" stopTime="1"/>', "")
    files = {"resources/decay.fmu": make_decay(("<ModelVariables>", f"{experiment}<ModelVariables>"))}
    loaded = load_ssp(make_ssp(ssd, files))
    assert (loaded.start, loaded.stop, loaded.step) == (0.0, 0.5 if experiment else 1.0, step)
