"""What an SSP file of others means: units, transformations, parameter sets, against the closed form of two FMUs in a row."""

from __future__ import annotations

from collections.abc import Callable
from math import exp
from pathlib import Path

import pytest
from ssp_support.packages import CONNECTION, NAMESPACES, SSD, binding, inline, of_second, of_system, parameter_set

from flexfmu.cosim.engine.master.linear_map import LinearMap
from flexfmu.cosim.engine.master.simulator import Outcome
from flexfmu.cosim.exchange.ssp.loading import load_ssp
from flexfmu.cosim.exchange.ssp.structure import SspError, SspUnit, ValueMap

pytestmark = pytest.mark.slow

MakeSsp = Callable[..., Path]
STEP, COUNT = 0.125, 8


def closed_form(
    factor: float = 1.0, offset: float = 0.0, rates: tuple[float, float] = (1.0, 1.0), start: float = 1.0
) -> float:
    """x2 at the end: x1 decays to zero; x2 follows factor x1 + offset, held over each step."""
    first, second = 1.0, start
    for _ in range(COUNT):
        fed = factor * first + offset
        second = fed + (second - fed) * exp(-rates[1] * STEP)
        first *= exp(-rates[0] * STEP)
    return second


def end(path: Path) -> float:
    """x2 at the end, in our master."""
    loaded = load_ssp(path, step=STEP)
    simulation = loaded.simulate()
    assert simulation.outcome is Outcome.COMPLETED, simulation.message
    return float(simulation.recording["second.x"].values[-1])


def test_two_foreign_fmus(make_ssp: MakeSsp) -> None:
    """FMUs that know nothing of ours, wired, with the file's stop time; integers are recorded too."""
    loaded = load_ssp(make_ssp(), step=STEP)
    simulation = loaded.simulate()
    assert simulation.recording["second.x"].values[-1] == pytest.approx(closed_form(), rel=1e-12)
    assert simulation.recording["first.x"].values[-1] == pytest.approx(exp(-1.0), rel=1e-12)
    assert simulation.recording["first.steps"].values[-1] == COUNT


def test_start_and_end_say_nothing_about_the_direction(make_ssp: MakeSsp) -> None:
    """The kinds of the connectors do."""
    turned = '<ssd:Connection startElement="second" startConnector="u" endElement="first" endConnector="x"/>'
    assert end(make_ssp(SSD.replace(CONNECTION, turned))) == pytest.approx(closed_form(), rel=1e-12)


def test_linear_transformation(make_ssp: MakeSsp) -> None:
    """target = factor * source + offset."""
    linear = CONNECTION.replace("/>", '><ssc:LinearTransformation factor="-3" offset="0.5"/></ssd:Connection>')
    assert end(make_ssp(SSD.replace(CONNECTION, linear))) == pytest.approx(closed_form(-3.0, 0.5), rel=1e-12)


@pytest.mark.parametrize(
    ("attributes", "inner", "factor", "offset"),
    [
        ("", "", 1e3, 0.0),
        ('suppressUnitConversion="true"', "", 1.0, 0.0),
        ("", '<ssc:LinearTransformation factor="2" offset="0.5"/>', 2e3, 0.5),
        ('suppressUnitConversion="true"', '<ssc:LinearTransformation factor="2"/>', 2.0, 0.0),
    ],
)
def test_units_are_converted(
    make_ssp: MakeSsp, make_decay: Callable[..., bytes], attributes: str, inner: str, factor: float, offset: float
) -> None:
    """From metres to an FMU in millimetres, before the transformation, or in its place."""
    unit = ('<Unit name="m"><BaseUnit m="1"/></Unit>', '<Unit name="mm"><BaseUnit m="1" factor="0.001"/></Unit>')
    millimetres = make_decay(unit, ('unit="m"', 'unit="mm"'))
    connection = CONNECTION.replace("/>", f" {attributes}>{inner}</ssd:Connection>")
    ssd = SSD.replace(CONNECTION, connection).replace(
        'name="second" source="resources/decay.fmu"', 'name="second" source="resources/small.fmu"'
    )
    assert end(make_ssp(ssd, {"resources/small.fmu": millimetres})) == pytest.approx(
        closed_form(factor, offset), rel=1e-12
    )


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


SET = parameter_set(
    rate='Real value="2.5"', x='Integer value="4"', label='String value="tired"', nobody='Real value="1"'
)


@pytest.mark.parametrize(
    "ssd",
    [
        of_second(inline(SET)),
        of_second(binding('source="resources/values.ssv"')),
        of_system(inline(SET, 'prefix="second."')),
        of_system(inline(SET.replace('name="', 'name="second.'), 'type="application/x-ssp-parameter-set"')),
    ],
    ids=["component", "external", "prefix", "hierarchical"],
)
def test_parameter_sets(make_ssp: MakeSsp, ssd: str) -> None:
    """Parameters and start values of states arrive, inline or not, at the component or at the system; what fits nothing is
    left out, as the standard has it, but told."""
    path = make_ssp(ssd, {"resources/values.ssv": SET})
    assert end(path) == pytest.approx(closed_form(rates=(1.0, 2.5), start=4.0), rel=1e-12)
    assert [name.rpartition(".")[2] for name in load_ssp(path, step=STEP).ignored if "set" not in name] == ["nobody"]


def test_the_system_outranks_its_components_and_later_sets_earlier_ones(make_ssp: MakeSsp) -> None:
    """As SSP 1.0 says of parameter bindings."""
    two, three = (parameter_set(rate=f'Real value="{rate}"') for rate in (2, 3))
    inner = inline(two) + inline(three)
    both = of_second(inner.replace("</ssd:ParameterBindings><ssd:ParameterBindings>", ""))
    assert end(make_ssp(both)) == pytest.approx(closed_form(rates=(1.0, 3.0)), rel=1e-12)
    outer = of_system(inline(parameter_set(second__rate='Real value="4"')), both)
    assert end(make_ssp(outer)) == pytest.approx(closed_form(rates=(1.0, 4.0)), rel=1e-12)


@pytest.mark.parametrize("external", [False, True])
def test_mapping(make_ssp: MakeSsp, external: bool) -> None:
    """Only mapped values count, transformed."""
    values = parameter_set(speed='Real value="2"', x='Real value="9"')
    entry = '<ssm:MappingEntry source="speed" target="rate"><ssc:LinearTransformation factor="3" offset="-1"/></ssm:MappingEntry>'
    mapping = f'<ssm:ParameterMapping {NAMESPACES} version="1.0">{entry}</ssm:ParameterMapping>'
    named = '<ssd:ParameterMapping source="resources/map.ssm"/>'
    held = named if external else f"<ssd:ParameterMapping>{mapping}</ssd:ParameterMapping>"
    path = make_ssp(of_second(inline(values, mapping=held)), {"resources/map.ssm": mapping})
    assert end(path) == pytest.approx(closed_form(rates=(1.0, 5.0)), rel=1e-12)


def test_units_of_parameters(make_ssp: MakeSsp) -> None:
    """A start value in millimetres for a state in metres, converted before it is transformed."""
    units = '<ssv:Units><ssc:Unit name="mm"><ssc:BaseUnit m="1" factor="0.001"/></ssc:Unit></ssv:Units>'
    values = parameter_set(x='Real value="2000" unit="mm"').replace("</ssv:Parameters>", f"</ssv:Parameters>{units}")
    assert end(make_ssp(of_second(inline(values)))) == pytest.approx(closed_form(start=2.0), rel=1e-12)
    entry = (
        '<ssm:MappingEntry source="x" target="x"><ssc:LinearTransformation factor="3" offset="-1"/></ssm:MappingEntry>'
    )
    held = f'<ssd:ParameterMapping><ssm:ParameterMapping {NAMESPACES} version="1.0">{entry}</ssm:ParameterMapping></ssd:ParameterMapping>'
    mapped = make_ssp(of_second(inline(values, mapping=held)))
    assert end(mapped) == pytest.approx(closed_form(start=5.0), rel=1e-12)


def test_the_systems_own_connectors(make_ssp: MakeSsp) -> None:
    """Outputs to the outside are no matter; an input from the outside stays at the value that its parameter set says."""
    outer = '<ssd:Connectors><ssd:Connector name="reference" kind="input"/><ssd:Connector name="result" kind="output"/></ssd:Connectors>'
    wires = (
        '<ssd:Connection startConnector="reference" endElement="second" endConnector="u"/>'
        '<ssd:Connection startElement="second" startConnector="x" endConnector="result"/>'
    )
    values = inline(parameter_set(reference='Real value="0.25"'))
    ssd = SSD.replace(CONNECTION, wires).replace("<ssd:Elements>", f"{outer}{values}<ssd:Elements>", 1)
    assert end(make_ssp(ssd)) == pytest.approx(closed_form(0.0, 0.25), rel=1e-12)


def test_times_where_the_file_says_none(make_ssp: MakeSsp, make_decay: Callable[..., bytes]) -> None:
    """The FMUs' default experiments stand in."""
    experiment = ("<ModelVariables>", '<DefaultExperiment stopTime="0.5" stepSize="0.125"/><ModelVariables>')
    ssd = SSD.replace('<ssd:DefaultExperiment startTime="0" stopTime="1"/>', "")
    loaded = load_ssp(make_ssp(ssd, {"resources/decay.fmu": make_decay(experiment)}))
    assert (loaded.start, loaded.stop, loaded.step) == (0.0, 0.5, 0.125)


def nested(outer: str = "", within: str = "", into: str = "", out: str = "", bindings: str = "") -> str:
    """The second FMU in a system ``inner`` of its own, whose connectors u (in mm), y and rate lead to it; the whole system
    shows ``result`` and has the parameter ``speed``. Arguments: bindings of the whole and of ``inner``, transformations on
    the way in and on the way out, bindings of the component."""
    head, rest = SSD.split('<ssd:Component name="second"')
    second, tail = rest.split("</ssd:Component>")
    second = second.replace(
        "</ssd:Connectors>", f'<ssd:Connector name="rate" kind="parameter"/></ssd:Connectors>{bindings}'
    )
    own = (
        '<ssd:Connectors><ssd:Connector name="u" kind="input"><ssc:Real unit="mm"/></ssd:Connector>'
        '<ssd:Connector name="y" kind="output"/><ssd:Connector name="rate" kind="parameter"/></ssd:Connectors>'
    )
    inner = "".join(
        [
            f'<ssd:System name="inner">{own}{within}',
            f'<ssd:Elements><ssd:Component name="second"{second}</ssd:Component></ssd:Elements><ssd:Connections>',
            f'<ssd:Connection startElement="" startConnector="u" endElement="second" endConnector="u">{into}</ssd:Connection>',
            '<ssd:Connection startConnector="rate" endElement="second" endConnector="rate"/>',
            '<ssd:Connection startElement="second" startConnector="x" endConnector="y"/></ssd:Connections></ssd:System>',
        ]
    )
    connections = (
        '<ssd:Connection startElement="first" startConnector="x" endElement="inner" endConnector="u"/>'
        '<ssd:Connection startConnector="speed" endElement="inner" endConnector="rate"><ssc:LinearTransformation factor="2"/></ssd:Connection>'
        f'<ssd:Connection startElement="inner" startConnector="y" endConnector="result">{out}</ssd:Connection>'
    )
    shown = '<ssd:Connectors><ssd:Connector name="result" kind="output"/><ssd:Connector name="speed" kind="parameter"/></ssd:Connectors>'
    ssd = f"{head.replace('<ssd:Elements>', f'{shown}{outer}<ssd:Elements>')}{inner}{tail}"
    return ssd.replace(CONNECTION, connections)


def test_nested_systems(make_ssp: MakeSsp) -> None:
    """Signals pass through the connectors of systems, converted and transformed on each connection, and are recorded under
    the connectors' names too."""
    into, out = (
        f'<ssc:LinearTransformation factor="{factor}" offset="{offset}"/>' for factor, offset in ((2, 3), (-1, 5))
    )
    loaded = load_ssp(make_ssp(nested(into=into, out=out)), step=STEP)
    recording = loaded.simulate().recording
    expected = closed_form(2.0, 3.0)  # mm after m: converted into mm and back into m, then transformed
    assert recording["inner.second.x"].values[-1] == pytest.approx(expected, rel=1e-12)
    assert (recording["inner.y"].values == recording["inner.second.x"].values).all()
    assert recording["result"].values[-1] == pytest.approx(5.0 - expected, rel=1e-12)
    assert recording["inner.u"].values[-1] == pytest.approx(1e3 * recording["first.x"].values[-1], rel=1e-12)
    assert (recording["inner.u"].unit, loaded.remarks) == ("mm", ())


def given(**values: float) -> str:
    """An inline parameter set of real values."""
    return inline(parameter_set(**{name: f'Real value="{value}"' for name, value in values.items()}))


def test_parameters_at_all_levels(make_ssp: MakeSsp) -> None:
    """A value reaches its FMU by name from each level and through parameter connectors, which outrank names; outer levels
    outrank inner ones; prefixes and mappings count at systems as they do at components; an empty source is none."""
    mapping = '<ssd:ParameterMapping source=""><ssm:ParameterMapping version="1.0"><ssm:MappingEntry source="a.b" target="second.rate"/><ssm:MappingEntry source="" target="second.x"/></ssm:ParameterMapping></ssd:ParameterMapping>'
    rates = {
        nested(): 1.0,
        nested(bindings=given(rate=2.0)): 2.0,
        nested(bindings=given(rate=2.0), within=given(second__rate=3.0)): 3.0,
        nested(within=inline(parameter_set(rate='Real value="4"'), 'prefix="second." source=""')): 4.0,
        nested(within=inline(parameter_set(b='Real value="5"'), 'prefix="a."', mapping)): 5.0,
        nested(within=given(rate=6.0)): 6.0,
        nested(within=given(second__rate=3.0), outer=given(inner__second__rate=7.0)): 7.0,
        nested(within=given(second__rate=3.0), outer=given(speed=4.5)): 9.0,
    }
    for ssd, rate in rates.items():
        loaded = load_ssp(make_ssp(ssd), step=STEP)
        found = loaded.simulate().recording["inner.second.x"].values[-1]
        assert found == pytest.approx(closed_form(rates=(1.0, rate)), rel=1e-12)
        assert loaded.ignored == ()


def test_tables(make_ssp: MakeSsp) -> None:
    """Booleans and items of enumerations are mapped by tables; a table that is a line counts as such."""
    entries = (
        '<ssm:MappingEntry source="flag" target="inverted"><ssc:BooleanMappingTransformation><ssc:MapEntry source="false" target="true"/></ssc:BooleanMappingTransformation></ssm:MappingEntry>'
        '<ssm:MappingEntry source="mood" target="trouble"><ssc:EnumerationMappingTransformation><ssc:MapEntry source="fine" target="none"/></ssc:EnumerationMappingTransformation></ssm:MappingEntry>'
    )
    mapping = f'<ssd:ParameterMapping><ssm:ParameterMapping version="1.0">{entries}</ssm:ParameterMapping></ssd:ParameterMapping>'
    values = parameter_set(flag='Boolean value="false"', mood='Enumeration value="fine"')
    assert end(make_ssp(of_second(inline(values, mapping=mapping)))) == pytest.approx(closed_form(-1.0), rel=1e-12)
    assert ValueMap(((False, True), (True, False))).linear() == LinearMap(-1.0, 1.0)
    assert ValueMap(((1, 10), (3, 20), (5, 30))).linear() == LinearMap(5.0, 5.0)
    assert ValueMap(((1, 1), (2, 4), (3, 9))).linear() is None


def table(kind: str, **pairs: str) -> str:
    """A table on a connection; names begin with a letter: ``_3="5"``."""
    entries = "".join(f'<ssc:MapEntry source="{a.lstrip("_")}" target="{b}"/>' for a, b in pairs.items())
    return f"<ssc:{kind}MappingTransformation>{entries}</ssc:{kind}MappingTransformation>"


def connected(source: str, target: str, inner: str) -> str:
    """The system with another connection between its components, whose connectors there are."""
    ends = f'startElement="first" startConnector="{source}" endElement="second" endConnector="{target}"'
    return SSD.replace(CONNECTION, f"<ssd:Connection {ends}>{inner}</ssd:Connection>")


@pytest.mark.parametrize("isolate", [False, None])
def test_tables_that_are_no_lines(make_ssp: MakeSsp, isolate: bool | None) -> None:
    """Integers are looked up at every communication point, through systems' connectors too, which show what comes of it."""
    squares = [0, 1, 4, 9, 16, 25, 36, 49, 64]
    steps = table("Integer", **{f"_{n}": str(square) for n, square in enumerate(squares)})
    path = make_ssp(connected("steps", "u", steps))
    recording = load_ssp(path, step=STEP).simulate(isolate=isolate).recording
    second = 1.0
    for square in squares[:-1]:
        second = square + (second - square) * exp(-STEP)
    assert recording["second.x"].values[-1] == pytest.approx(second, rel=1e-12)
    out = '<ssd:Connectors><ssd:Connector name="result" kind="output"/></ssd:Connectors>'
    shown = (
        f'<ssd:Connection startElement="first" startConnector="steps" endConnector="result">{steps}</ssd:Connection>'
    )
    ssd = SSD.replace("<ssd:Elements>", f"{out}<ssd:Elements>").replace(CONNECTION, shown)
    recording = load_ssp(make_ssp(ssd), step=STEP).simulate(isolate=isolate).recording
    assert recording["result"].values.tolist() == squares


def test_values_that_a_table_lacks(make_ssp: MakeSsp) -> None:
    """The run ends where the signal leaves the table, with its value and what the table has."""
    path = make_ssp(connected("steps", "u", table("Integer", _0="7", _1="0", _2="1")))
    simulation = load_ssp(path, step=STEP).simulate()
    assert simulation.outcome is Outcome.STEP_FAILED
    assert (
        "first failed at 0.375 s: the table of a connection has nothing for 3, only for 0, 1, 2" in simulation.message
    )
    assert simulation.recording.time[-1] == pytest.approx(0.25)


def test_tables_of_items(make_ssp: MakeSsp, make_decay: Callable[..., bytes]) -> None:
    """Names of items are those of the enumerations at the connection's ends."""
    variables = "".join(
        f'<ScalarVariable name="{name}" valueReference="1" causality="{causality}" variability="discrete"><Enumeration '
        f'declaredType="Trouble"{start}/></ScalarVariable>'
        for name, causality, start in (("mood", "output", ""), ("task", "input", ' start="1"'))
    )
    fmu = {"resources/decay.fmu": make_decay(("</ModelVariables>", f"{variables}</ModelVariables>"))}
    items = table("Enumeration", ends="ends", none="fails")
    ssd = connected("mood", "task", items).replace("<ssc:Integer/>", "<ssc:Enumeration name='Trouble'/>")
    ssd = ssd.replace('name="steps"', 'name="mood"').replace('name="inverted"', 'name="task"')
    simulation = load_ssp(make_ssp(ssd, fmu), step=STEP).simulate()
    assert simulation.recording["second.mood"].values[-1] == 2.0
    assert "second failed at 0.5 s" in simulation.message
    with pytest.raises(SspError, match=r"with the item 'fine', which first\.mood doesn't have; it has: none, fails"):
        load_ssp(make_ssp(ssd.replace('source="none"', 'source="fine"'), fmu), step=STEP)


def test_ssp_2(make_ssp: MakeSsp) -> None:
    """A file of SSP 2.0 with what 1.0 has runs, types of FMI 3.0 included."""
    ssd = SSD.replace('version="1.0" name', 'version="2.0" name').replace("ssc:Real", "ssc:Float64")
    ssd = of_second(inline(parameter_set(rate='Float64 value="2"')), ssd.replace("ssc:Integer", "ssc:Int32"))
    assert end(make_ssp(ssd)) == pytest.approx(closed_form(rates=(1.0, 2.0)), rel=1e-12)


def test_what_other_tools_write(make_ssp: MakeSsp) -> None:
    """What contradicts the standard or an FMU without harm is passed over and told: connectors that nothing is connected to,
    units that nothing defines, a parameter given twice, model exchange, prefixes that aren't declared."""
    ssd = SSD.replace('name="steps" kind="output"', 'name="_start" kind="parameter"')
    ssd = ssd.replace('name="second" source', 'name="second" implementation="ModelExchange" source')
    one = '<ssv:Parameter name="rate"><ssv:Real value="3"/></ssv:Parameter><ssv:Parameters>'
    values = parameter_set(rate='Real value="2"', x='Real value="4" unit="[m]"')
    values = values.replace("<ssv:Parameters>", one.replace("<ssv:Parameters>", "").join(["<ssv:Parameters>", ""]))
    bound = of_second(binding('source="values.ssv"'), ssd)
    loaded = load_ssp(make_ssp(bound, {"values.ssv": values.replace(NAMESPACES, "")}), step=STEP)
    assert loaded.simulate().recording["second.x"].values[-1] == pytest.approx(
        closed_form(rates=(1.0, 2.0), start=4.0), rel=1e-12
    )
    for fact in ("'_start'", "'[m]' isn't defined", "'rate' twice, 2.0 counts", "is for model exchange"):
        assert [fact in remark for remark in loaded.remarks].count(True) == 1, fact
    assert len(loaded.remarks) == 4


def test_variants(make_ssp: MakeSsp) -> None:
    """A package may hold several systems: the default runs, the others are told and can be asked for, in folders too."""
    slow = of_second(inline(parameter_set(rate='Real value="0.5"')))
    moved = slow.replace("resources/", "../resources/")
    path = make_ssp(files={"slow.ssd": slow, "deep/slow.ssd": moved})
    assert end(path) == pytest.approx(closed_form(), rel=1e-12)
    assert load_ssp(path, step=STEP).remarks == (
        "took SystemStructure.ssd; the file also holds deep/slow.ssd, slow.ssd (--ssd)",
    )
    for name in ("slow.ssd", "deep/slow.ssd"):
        recording = load_ssp(path, step=STEP, ssd=name).simulate().recording
        assert recording["second.x"].values[-1] == pytest.approx(closed_form(rates=(1.0, 0.5)), rel=1e-12)


@pytest.mark.parametrize(
    "inner", ['<o:FixedStepMaster stepSize="0.25"/>', '<o:SimulationInformation fixedStepSize="0.25"/>']
)
def test_omsimulators_step(make_ssp: MakeSsp, inner: str) -> None:
    """The communication step in annotations of OMSimulator 2 and 3."""
    note = f'<ssd:Annotations><ssc:Annotation type="org.openmodelica"><o:A xmlns:o="o">{inner}</o:A></ssc:Annotation></ssd:Annotations></ssd:System>'
    assert load_ssp(make_ssp(SSD.replace("</ssd:System>", note))).step == 0.25
