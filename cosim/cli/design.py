"""`flexfmu modes`, `margins`, `response`, `effects`, `tune`, `shaper` and `plan`: natural frequencies, distance from instability, and what each effect is
worth; gains and other keys of a scene, chosen by runs; input shapers, designed for a scene and tried; the best motion within limits."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from math import isfinite
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from flexfmu.cosim.cli import console
from flexfmu.cosim.cli.options import ProcessesOption
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.files import to_json
from flexfmu.model.scene.keys import parse_setting

if TYPE_CHECKING:
    from rich.console import RenderableType

    from flexfmu.cosim.design.gains.tuner import TuneResult
    from flexfmu.cosim.design.plans.plan_result import DriveTable, PlanResult
    from flexfmu.model.scene.schema import Scene


def modes(
    scene: str,
    poses: Annotated[int, typer.Option(min=3, max=10_001)] = 11,
    settings: list[str] | None = None,
    json: bool = False,
) -> int:
    """Natural frequencies along the path, with the motors locked, about the static equilibrium.

    Args:
        poses (N): Poses along the path: an odd number, so that the middle is one.
    """
    from flexfmu.cosim.experiment.planning import plan
    from flexfmu.cosim.reports.modes_table import modes_along_path, modes_table

    robot = console.load_resolved(scene, settings)
    with console.progress() as show:
        show("frequencies along the path", None)
        found = modes_along_path(plan(robot), poses, lambda fraction: show("frequencies along the path", fraction))
    data = {"scene": robot.name, "poses": [asdict(pose) for pose in found]}
    console.print_result(json, data, *modes_table(robot.name, found))
    return 0


def margins(
    scene: str,
    poses: Annotated[int, typer.Option(min=1)] = 5,
    payload_band: str | None = None,
    identified: Path | None = None,
    response: Path | None = None,
    out: Path | None = None,
    settings: list[str] | None = None,
    json: bool = False,
) -> int:
    """Gain, phase, delay and disk margins of a sampled loop, about standstill along the path.

    The worst poses along the path are searched. The loop is cut at each torque, then at both at once. Holds, delays,
    encoders, lags and several sample rates count exactly;
    rounding and limits don't count. The exit status is 1 if the loop is unstable.

    Args:
        poses (N): Equally spaced poses along the path, in addition to the worst ones; 1 for its end alone.
        payload_band (BAND): Payloads among which the worst one is searched, unknown to the controllers: 0.2 for 20 % to both
            sides, 4,8 for 4 to 8 kg, or an identified.json for its interval. Default: the scene's alone.
        identified (FILE.json): What `flexfmu identify --out` found: margins of robots at the edge of what it leaves likely, all estimates
            and their correlations together, unknown to the controllers. Default: the scene's robot alone.
        response (FILE): A measured response of the robot at the end of the path (.csv, .mat), in place of the model's in its band; margins
            have standard errors. Default: the model's.
        out (DIR): Folder for margins.html, margins.csv, bode.png, nyquist.png and root-locus.png. Default: no files.
    """
    from flexfmu.cosim.design.gains.robustness import band_masses, parse_band
    from flexfmu.cosim.design.identification.result import identified_robots
    from flexfmu.cosim.design.margins.scene_margins import margins_data, margins_table, scene_margins, write_margins
    from flexfmu.cosim.design.response.response import as_response

    robot = console.load_resolved(scene, settings)
    if out is not None:
        console.prepared_folder(out)
    masses = () if payload_band is None else band_masses(robot, parse_band(payload_band))
    with console.progress() as show:
        result = scene_margins(
            robot,
            poses=poses,
            payloads=masses,
            robots=identified_robots(robot, identified),
            response=as_response(response),
            progress=lambda fraction: show("margins along the path", fraction),
        )
        files: list[Path] = []
        if out is not None:
            show("drawing", None)
            files = write_margins(result, out)
    where = [f"files: {', '.join(map(str, files))}"] if files else []
    data = {**margins_data(result), "files": [str(path) for path in files]}
    console.print_result(json, data, *margins_table(result), *where)
    return 0 if result.is_stable else console.FAILURE


def response(
    logs: list[Path],
    inputs: list[str] | None = None,
    outputs: list[str] | None = None,
    mapping: list[str] | None = None,
    period: float | None = None,
    segment: float | None = None,
    reference: list[str] | None = None,
    between: str | None = None,
    band: str | None = None,
    continuous: bool = False,
    modes: int | None = None,
    out: Path | None = None,
    json: bool = False,
) -> int:
    """Frequency response of a robot or loop from logs, or a file of one, with standard errors, coherence and modes.

    Periodic excitation is averaged over its periods, anything else by Welch's method. Writes what `flexfmu margins --response` reads.

    Args:
        logs (FILE.csv): Files with a column `time` and the signals (.csv, .mat, .parquet), experiments of one system; or without
            --input a file of a response.
        inputs (--input SIGNAL): Input, or a sum: joint1.torque+joint1.disturbance; may be repeated. Default: none, for a response.
        outputs (--output SIGNAL): Output; may be repeated. Default: none, for a response.
        mapping (--map COLUMN=SIGNAL): What a column of the logs is, as for `flexfmu identify`: M1=joint1.torque*1e-3; may be repeated.
            Default: by the names.
        period (SECONDS): Period of the excitation, of which the first is left out. Default: Welch's method.
        segment (SECONDS): Length of Welch's segments. Default: eight over the log.
        reference (SIGNAL): What excites a closed loop; may be repeated. Default: the input.
        between (FROM:TO): Part of the logs in s, 0.7:5.7. Default: all.
        band (FROM:TO): Frequencies in Hz, 1:400. Default: all that are excited.
        continuous: The input isn't held between samples. Default: it is, as a controller's.
        modes (N): Number of modes. Default: as many as the response shows.
        out (DIR): Folder for response.csv, response.png and modes.csv, logs for `flexfmu identify`. Default: no files.
    """
    from flexfmu.cosim.design.response.estimate import estimate_response
    from flexfmu.cosim.design.response.response import FrequencyResponse
    from flexfmu.cosim.engine.files import replacing, write_whole
    from flexfmu.cosim.engine.measured import parse_interval, parse_mapping
    from flexfmu.cosim.reports.terminal import titled_table

    if not inputs and not outputs and len(logs) == 1:
        found = FrequencyResponse.read(logs[0])
    elif not inputs or not outputs:
        raise InputError("a response leads from an --input to an --output, names of signals of the log")
    else:
        found = estimate_response(
            logs, inputs, outputs, period=period, segment=segment, reference=reference or (), held=not continuous,
            between=None if between is None else parse_interval("--between", between),
            band=None if band is None else parse_interval("--band", band), mapping=dict(map(parse_mapping, mapping or ())),
        )  # fmt: skip
    fitted, files = found.modes(modes), list[Path]()
    if out is not None:
        folder = console.prepared_folder(out).path
        files = [found.write(folder / "response.csv"), folder / "response.png"]
        with replacing(files[1]) as path:
            fitted.plot().savefig(path, format="png", dpi=130)
        if fitted.modes:
            files.append(write_whole(folder / "modes.csv", fitted.to_csv()))
    table = titled_table("Modes, ± standard errors", numbers=("frequency\nHz", "damping\n%"))
    for each in fitted.modes:
        scaled = (1.0, each.frequency), (100.0, each.damping_ratio)
        table.add_row(*(f"{scale * value:.5g} ± {scale * (value.error or 0.0):.2g}" for scale, value in scaled))
    data = {"response": found.rows(), "sample_time": found.sample_time, "modes": fitted.rows(), "misfit": fitted.misfit}
    where = [f"files: {', '.join(map(str, files))}"] if files else []
    misfit = f"residuals of the fit: {fitted.misfit:.3g} of the response's {'magnitude' if found.standard_error is None else 'standard errors'}"
    console.print_result(json, data | {"files": [str(path) for path in files]}, repr(found), table, misfit, *where)
    return 0


def effects(
    scene: str,
    tolerance: float | None = None,
    of: list[str] | None = None,
    check: bool = False,
    out: Path | None = None,
    restart: bool = False,
    settings: list[str] | None = None,
    json: bool = False,
) -> int:
    """Choose the cheapest elastic effects within a tolerance; shows the accuracy and the cost of each.

    Writes effects.json. Every estimate and run is kept at once, and whatever ends the command, the same command continues.

    Args:
        tolerance (RELATIVE): Largest error. Default: the scene's, or 0.01.
        of (METRIC): A metric to hold; may be repeated. Default: the scene's, or three of them.
        check: Also run the next richer sets and compare; builds their FMUs. Default: skip.
        out (DIR): Folder of the results. Default: results/<name of the scene>-effects.
        restart: Discard what an interrupted choice for another scene has left in the folder. Default: refuse.
    """
    from flexfmu.cosim.design.effects.choice import requirements
    from flexfmu.cosim.design.effects.study import comparison_table, comparisons, report, study_data, study_effects
    from flexfmu.cosim.many.journal import WorkJournal, about_scene

    robot, asked = console.load_changed(scene, settings), tuple(of or [])
    about = about_scene(robot) | {"of": requirements(robot, tolerance, asked)[1]}
    folder = console.prepared_folder(out or console.usual_folder(robot.name, settings, "-effects"))
    journal = WorkJournal(folder.path, "choice of effects", about, restart=restart, note=console.show_note)
    with console.progress() as show:
        study = study_effects(robot, tolerance, asked, show, journal)
        checked = tuple(comparisons(study, show, journal)) if check else ()
    data = study_data(study, checked)
    folder.write("effects.json", to_json(data))
    journal.remove()
    compared = [comparison_table(checked)] if check else []
    console.print_result(json, data, *report(study), *compared, f"results: {folder.path / 'effects.json'}")
    return 0


def identify(
    scene: str,
    logs: Annotated[list[str] | None, typer.Argument()] = None,
    free: list[str] | None = None,
    mapping: list[str] | None = None,
    prior: list[str] | None = None,
    sensors: str | None = None,
    loss: Literal["linear", "robust"] = "linear",
    starts: Annotated[int, typer.Option(min=1, max=1000)] = 1,
    seed: Annotated[int, typer.Option(min=0)] = 0,
    segment: list[str] | None = None,
    explain: bool | None = None,
    step: float | None = None,
    strict: bool = False,
    design: bool = False,
    criterion: Literal["D", "A"] = "D",
    signal: list[str] | None = None,
    noise: float = 0.01,
    sample_time: float = 1e-3,
    output: Path | None = None,
    out: Path | None = None,
    settings: list[str] | None = None,
    json: bool = False,
) -> int:
    """Estimate parameters of a scene's robot, or of anybody's FMU, from measurements.

    A log is a CSV file with a header and a column `time`; columns named like signals are taken. A frequency response, or a table
    of modes, with `frequency` in place of the time, is compared with small motions about the end of the path. References or angles of both
    joints drive a motion-driven robot, torques of both motors a torque-driven one without controllers; else it makes the
    scene's own motion. What else there is, torques, accelerations or strains, is compared. Noise may be coloured: it is
    modelled from the residuals. The exit status is 1 if residuals show that the model lacks something.

    With --design, without a log: which motion would determine the parameters best, within the limits of torque and velocity of
    the scene's motors or of its own motion, and the standard errors to be expected.

    Args:
        scene (SCENE): A scene, or an FMU (.fmu), whose inputs and outputs a log's columns are.
        logs (LOG.csv): A log; LOG.csv:KEY=VALUE,KEY=VALUE changes the scene for it alone, as heavy.csv:payload.mass=6,
            and for responses and modes the pose: modes.csv:pose=[0.1,0.3].
        free (KEY): A parameter to estimate, payload.mass, with a first value, motor_inertia=0.01, or bounds, payload.mass=3:9; may
            be repeated, or several with commas. Default: none, at least one is needed.
        mapping (--map COLUMN=SIGNAL): What a measured column is, with a factor or a unit and an offset if needed:
            tau1=joint1.torque*1e-3, sg=link11.strain[0.25], t=time*ms. May be repeated. Default: by the names.
        prior (KEY=VALUE+-DEVIATION): What is known of a free parameter: payload.mass=6+-0.5; may be repeated. Default: none.
        sensors (NAMES): What is unknown of sensors: delay, offset and gain, with commas; none for nothing. Default:
            delay,offset, with an FMU none.
        loss (NAME): linear, or robust against outliers.
        starts (N): First values from which the least squares are looked for, drawn within the bounds.
        seed (N): Seed of these.
        segment (FROM:TO): Times of the logs that count, in s; may be repeated. Default: all.
        explain: Try effects that the scene lacks on the residuals; each needs an FMU. Default: where they aren't noise, or several parameters are free.
        step (SECONDS): Communication step with an FMU. Default: its own.
        strict: Refuse logs with values that are no finite numbers (nan, inf). Default: leave them out and tell the line.
        design: Propose a motion instead. Default: estimate from logs.
        criterion (NAME): Of --design: D, the determinant of the relative covariance, or A, its trace.
        signal (NAME): Of --design: what will be measured; may be repeated. Default: both torques.
        noise (RELATIVE): Of --design: standard deviation of noise relative to each signal's largest value.
        sample_time (SECONDS): Of --design: distance of the log's samples.
        output (-o, --output FILE.toml): Write the scene with the identified values, or with the proposed motion, here. Default:
            nowhere.
        out (DIR): Write identified.html, identified.json and draws.csv, cases for `flexfmu sweep`, there. Default: nowhere.
    """
    from flexfmu.cosim.design.gains.goals import split
    from flexfmu.cosim.design.identification.experiments import TORQUES, ProposedMotions, propose_motions
    from flexfmu.cosim.design.identification.result import Identification
    from flexfmu.cosim.design.identification.study import (
        Estimation,
        free_parameters,
        identify_fmu,
        identify_scene,
        parse_log,
        parse_prior,
        parse_sensors,
    )
    from flexfmu.cosim.design.scene_files import write_changed
    from flexfmu.cosim.engine.measured import parse_interval, parse_mapping
    from flexfmu.cosim.reports.terminal import as_terminal_table

    # usage
    is_fmu = scene.endswith(".fmu")
    if design and (logs or is_fmu):
        raise InputError("--design takes a scene and no log")
    if not (design or logs):
        raise InputError("there is no log: name at least one, or take --design")
    if is_fmu and (settings or output is not None or explain):
        raise InputError(f"{scene} is an FMU: --set, --explain and -o are for scenes")
    if step is not None and not is_fmu:
        raise InputError("--step is for FMUs: a scene has its own, --set cosimulation.step=1e-4 for example")
    sources, parameters = [parse_log(each) for each in logs or ()], split(free or ())
    unknown = parse_sensors(sensors, () if is_fmu else ("delay", "offset"))
    meaning, priors = dict(map(parse_mapping, mapping or ())), dict(map(parse_prior, split(prior or ())))
    segments = [parse_interval("--segment", each) for each in segment or ()]
    console.check_scene_file(output)
    if out is not None and not design:
        console.prepared_folder(out)
    # estimate, or propose a motion
    robot = None if is_fmu else console.load_resolved(scene, settings)
    found: Identification | ProposedMotions
    with console.progress() as show:
        wanted = Estimation(parameters, unknown, meaning, priors, loss, starts, seed, segments, strict, show)
        if robot is None:
            found = identify_fmu(Path(scene), sources, wanted, step)
        elif design:
            found = propose_motions(
                *free_parameters(robot, parameters, {}, show),
                signals=signal or TORQUES,
                noise=noise,
                sample_time=sample_time,
                sensors=unknown,
                criterion=criterion,
                show=show,
            )
        else:
            found = identify_scene(robot, sources, wanted, explain)
    files = [each for each in (output, out if isinstance(found, Identification) else None) if each is not None]
    shown: list[RenderableType]
    if isinstance(found, Identification):
        changes, shown = found.changes, [*map(as_terminal_table, found.tables()), *found.messages]
        if out is not None:
            found.write(out)
    else:
        changes, shown = found.best.changes, [as_terminal_table(found.table()), repr(found)]
    if output is not None:
        write_changed(scene, output, {**dict(map(parse_setting, settings or ())), **changes})
    console.print_result(json, found.as_data(), *shown, *(f"files: {each}" for each in files))
    return console.FAILURE if isinstance(found, Identification) and not found.is_explained else 0


def tune(
    scene: str,
    over: list[str] | None = None,
    minimise: str = "rms_tracking_error",
    subject_to: list[str] | None = None,
    payload_band: str | None = None,
    identified: Path | None = None,
    response: Path | None = None,
    start: str | None = None,
    method: str = "gradient",
    trials: Annotated[int | None, typer.Option(min=2)] = None,
    seed: Annotated[int, typer.Option(min=0)] = 0,
    processes: ProcessesOption = None,
    output: Path | None = None,
    out: Path | None = None,
    restart: bool = False,
    settings: list[str] | None = None,
    json: bool = False,
) -> int:
    """Search gains and other keys of a scene that minimise a metric within limits.

    Writes tuned.toml, which every command takes, and all trials as tune.csv. Every trial is kept at once: after Ctrl-C the best
    so far is written, and the same command continues.

    Args:
        over (KEY=FROM:TO): A key of the scene and the interval of its values: pd.kp=1e3:1e5, controller[0].derivative=10:500;
            may be repeated, or several with commas. Default: none, at least one is needed.
        minimise (FIGURE): A metric; without a joint number the larger value of both joints: rms_tracking_error, settling_time.
        subject_to (CONDITION): FIGURE<LIMIT or FIGURE>LIMIT, in SI units or with a unit: peak_torque<80, settling_time<20ms,
            margin>6dB, phase_margin>40deg; may be repeated, or several with commas. Default: none.
        payload_band (BAND): Payloads for which the limits hold, unknown to the controllers: 0.2 for 20 % to both sides,
            4,8 for 4 to 8 kg, or an identified.json for its interval. Default: the scene's alone.
        identified (FILE.json): What `flexfmu identify --out` found: the limits also hold for robots at the edge of what it leaves likely,
            all estimates and their correlations together, unknown to the controllers. Default: the scene's robot alone.
        response (FILE): A measured response of the robot for margins, see `flexfmu margins`. Default: the model's.
        start (KIND:HZ): Begin with gains for a bandwidth, in place of the scene's controllers: pd:10, pid:10 or cascade:10;
            feedforward stays. Default: the scene's.
        method (NAME): How the best first trials are improved: gradient, by differences of runs; sample, not at all.
        trials (N): Number of trials. Default: some 50 for each key.
        seed (N): Seed of the first trials.
        output (-o, --output FILE.toml): Write the tuned scene here. Default: into the folder of the results.
        out (DIR): Folder of the results. Default: results/<name of the scene>-tune.
        restart: Discard the trials of another tuning in the folder. Default: refuse.
    """
    import os

    from flexfmu.cosim.design.gains.goals import split
    from flexfmu.cosim.design.gains.robustness import parse_band
    from flexfmu.cosim.design.gains.tuner import summary, tune_scene, write_tuned, write_tuning
    from flexfmu.cosim.design.identification.result import identified_robots
    from flexfmu.cosim.design.response.response import as_response

    console.check_scene_file(output)
    robot = console.load_resolved(scene, settings)
    folder = out or console.usual_folder(robot.name, settings, "-tune")
    changes = dict(map(parse_setting, settings or ()))
    if start is not None:
        robot = _started(robot, start)
        changes["controller"] = robot.model_dump(mode="json", exclude_none=True, exclude_defaults=True)["controller"]
    with console.progress() as show:
        result = tune_scene(
            robot,
            split(over or ()),
            minimise,
            split(subject_to or ()),
            payload_band=None if payload_band is None else parse_band(payload_band),
            robots=identified_robots(robot, identified),
            response=as_response(response),
            method=method,
            trials=trials,
            seed=seed,
            processes=processes or os.cpu_count() or 1,
            folder=folder,
            restart=restart,
            show=show,
            note=console.show_note,
        )
    target = output or folder / "tuned.toml"
    files = [write_tuned(result, target, scene, changes), *write_tuning(result, folder)]
    if result.interrupted:
        console.show_note("interrupted: these are the best values so far; the same command continues")
    names = [str(path) for path in files]
    console.print_result(json, {**summary(result), "files": names}, *_shown_tuning(result, names))
    return 0 if result.is_feasible and not result.interrupted else console.FAILURE


def _started(scene: Scene, text: str) -> Scene:
    """The scene with the controller of ``KIND:HZ``.

    Raises:
        InputError: it has another form.
    """
    from flexfmu.cosim.design.gains.starts import started

    kind, _, number = text.partition(":")
    try:
        bandwidth = float(number.removesuffix("Hz"))
    except ValueError:
        raise InputError(f"--start takes KIND:HZ, cascade:10 for example, got {text!r}") from None
    return started(scene, kind, bandwidth)  # type: ignore[arg-type]


def _shown_tuning(result: TuneResult, files: Sequence[str]) -> Iterator[RenderableType]:
    """The values, the figures, what to try, and the files."""
    from rich.text import Text

    from flexfmu.cosim.reports.terminal import as_terminal_table

    yield from map(as_terminal_table, result.tables())
    if not result.is_feasible:
        yield Text("No trial keeps all limits; these values miss them least.", style="yellow")
    # within 1 % of an end of the interval
    for each in result.study.over:
        if each.key in result.values and not 0.01 < each.share_of(result.values[each.key]) < 0.99:
            yield Text(f"{each.key} is at the end of its interval: a wider one may be better.", style="yellow")
    failed = sum(1 for each in result.trials if each.message)
    yield f"{len(result.trials)} trials, {failed} of which failed; results: {', '.join(files)}"


def shaper(
    scene: str,
    out: Path | None = None,
    payload_errors: bool = False,
    payload_band: float = 0.3,
    drive: Literal["perfect", "controller"] | None = None,
    max_deviation: float | None = None,
    max_added_time: float | None = None,
    max_jerk: float | None = None,
    max_torque: float | None = None,
    output: Path | None = None,
    settings: list[str] | None = None,
    json: bool = False,
) -> int:
    """Design input shapers for a scene, try them all in co-simulation and recommend one, with the TOML that applies it.

    Writes shapers.json, shapers.csv and the picture of the sensitivity.

    Args:
        out (DIR): Folder of the results. Default: results/<name of the scene>.
        payload_errors: Seven payload errors instead of five. Default: five.
        payload_band (FRACTION): Largest error of the payload's mass, either way.
        drive: What drives the robot: exactly its references, or the scene's controllers and imperfections. Default: the
            controllers where the scene has some.
        max_deviation (METRES): Largest deviation from the path. Default: no limit.
        max_added_time (SECONDS): Longest time that the shaper may add. Default: no limit.
        max_jerk (RAD/S3): Largest jerk of a joint reference. Default: no limit.
        max_torque (N.M): Largest torque of a motor over the payload band. Default: no limit.
        output (--output, -o FILE.toml): Write the scene with the recommended shaper here. Default: nowhere.
    """
    from flexfmu.cosim.design.shapers.examination import COARSE, FINE, examine, report, study_data, to_csv
    from flexfmu.cosim.design.shapers.figure import save_sensitivity
    from flexfmu.cosim.design.shapers.recommendation import write_shaped

    # usage
    if not 0.0 <= payload_band < 1.0:
        raise InputError(f"--payload-band must be at least 0 and below 1 (0.3 is 30 %), got {payload_band:g}")
    given = {"deviation": max_deviation, "added_time": max_added_time, "jerk": max_jerk, "torque": max_torque}
    limits = {name: limit for name, limit in given.items() if limit is not None}
    for name, limit in limits.items():
        if not 0.0 <= limit < float("inf"):
            raise InputError(f"--max-{name.replace('_', '-')} must be a number from 0 on, got {limit:g}")
    # design, simulate, and write
    robot = console.load_resolved(scene, settings)
    folder = console.prepared_folder(out or console.usual_folder(robot.name, settings))
    with console.progress() as show:
        study = examine(robot, payload_band, FINE if payload_errors else COARSE, show, drive, limits)
        show("writing the results", None)
        data = study_data(study)
        folder.write("shapers.json", to_json(data))
        folder.write("shapers.csv", to_csv(study.results))
        save_sensitivity(study, folder.path)
    # the shaped scene, and standard output
    if output is not None and study.recommendation.keeps_limits:
        write_shaped(
            scene, study.recommendation.result.candidate.section, output, dict(map(parse_setting, settings or ()))
        )
    console.print_result(json, data, *report(study, folder.path, output))
    # nothing keeps the limits
    if not study.recommendation.keeps_limits:
        console.show_note(study.recommendation.reason + (f"; {output} is not written" if output is not None else ""))
        return console.FAILURE
    return 0


def plan(
    scene: str,
    output: Path | None = None,
    out: Path | None = None,
    minimise: str | None = None,
    duration: float | None = None,
    residual: float | None = None,
    payload_band: str | None = None,
    identified: Path | None = None,
    stiffness_band: float | None = None,
    damping_band: float | None = None,
    limit: list[str] | None = None,
    margin: float | None = None,
    corridor: float | None = None,
    return_payload: Annotated[float | None, typer.Option(min=0.0)] = None,
    pause: Annotated[float | None, typer.Option(min=0.0)] = None,
    front: str | None = None,
    method: list[str] | None = None,
    candidate: list[Path] | None = None,
    warm_start: Path | None = None,
    budget: Annotated[float | None, typer.Option(min=0.0)] = None,
    seed: int | None = None,
    processes: ProcessesOption = None,
    robust: bool = True,
    restart: bool = False,
    export: Path | None = None,
    rate: float | None = None,
    unit: str | None = None,
    counts: float | None = None,
    live: bool = False,
    settings: list[str] | None = None,
    json: bool = False,
) -> int:
    """Plan the fastest motion that leaves no vibration, within limits that hold over a band of payloads.

    Writes planned.toml, which every command takes, the Pareto front as front.csv, and plan.html, which
    compares the planned with the given motion. After Ctrl-C the best motion so far is written. All that is found is kept at once:
    whatever ends the command, the same command continues.

    Args:
        output (-o, --output FILE.toml): Also write the planned scene here. Default: only into --out.
        out (DIR): Folder of the results. Default: results/<name of the scene>-plan.
        minimise (WHAT): time, torque, rms_torque, energy or residual; all but time need --duration. Default: the scene's, or
            time.
        duration (SECONDS): Total time, for all but time, in a cycle with its pauses. Default: the scene's.
        residual (METRES): Largest residual vibration. Default: the scene's, or 1e-6.
        payload_band (BAND): Payloads for which the limits hold: 0.3 for 30 % to both sides, 4,8 for 4 to 8 kg, or an identified.json
            for its interval. Default: the scene's, or 0.3.
        identified (FILE.json): What `flexfmu identify --out` found: bands of payload, stiffness and damping that contain its intervals.
            Default: those of the scene.
        stiffness_band (FRACTION): Relative change of Young's modulus to both sides. Default: the scene's, or 0.
        damping_band (FRACTION): Relative change of the damping to both sides. Default: the scene's, or 0.
        limit (NAME=VALUE): A limit in SI units, torque=80, as a multiple of the given motion's, jerk=2.5x, or power=free: torque, speed,
            acceleration, jerk, rms_torque, power, energy, supply_power, regenerated_power, regenerated_energy, motor_torque,
            motor_rms_torque, motor_speed, reaction, stress, off_path; may be repeated. Default: speed=2.5x, acceleration=2.5x, jerk=2.5x and
            what the section `motor` says, without it torque=1x, rms_torque=1x, power=1x.
        margin (METRES): How far the motion may enter the keep-out region. Default: the scene's, or 1e-4.
        corridor (METRES): How far the motion may leave the given path to the outside. Default: the scene's, or 0.01.
        return_payload (KG): Plan a cycle: the way back too, with this payload, 0 for an empty return. RMS torques and energy are limited over
            the cycle. Default: the scene's, or a single motion.
        pause (SECONDS): Plan a cycle that rests so long at each place. Default: the scene's, or 0.1 in a cycle.
        front (FIGURES): Also the front of two or three figures, time,power for example, by optimal control: time, residual, energy, power,
            rms_torque, jerk, with what is minimised among them. Default: the scene's, or the front of all motions found.
        method (NAME): search, flexible or optimal; may be repeated. Default: optimal, and all of them beside a front or where it finds no
            motion within all limits.
        candidate (FILE.csv): A motion of your own, of joints or end effector, to compare; may be repeated.
            Default: none.
        warm_start (DIR): The folder of an earlier plan, for another start or payload for example: optimal control goes on from its motion, in
            a few seconds, alone unless --method says more. Default: a plan from the beginning.
        budget (SECONDS): End after this time with the best motion so far, as after Ctrl-C. Default: no limit.
        seed (N): Seed of the search. Default: the scene's, or 0.
        robust: Evaluate the chosen motion in richer models too.
        restart: Discard what an interrupted plan for another scene or other limits has left in the folder. Default: refuse.
        export (FILE.csv): Also write the planned motion as a drive reads it: position, velocity, acceleration and torque of both joints at
            each sample; it is judged what residual vibration these samples leave. Default: none.
        rate (HZ): Samples a second of --export. Default: 4000.
        unit (UNIT): Angles of --export: rad, deg or turn. Default: rad.
        counts (N): Encoder counts of a joint's turn: angles of --export are whole counts. Default: no rounding.
        live: Also write live.html, the report of the planned motion, which simulates: sliders change payload, stiffness and more. It needs
            ziglang. Default: plan.html alone.
    """
    import os

    from flexfmu.cosim.design.gains.robustness import parse_band
    from flexfmu.cosim.design.identification.result import Identification
    from flexfmu.cosim.design.plans.assessment import own_candidate
    from flexfmu.cosim.design.plans.plan_result import check_drive, planned_scenes, summary, write_plan, write_scene
    from flexfmu.cosim.design.plans.planner import about_plan, plan_scene
    from flexfmu.cosim.engine.files import write_whole
    from flexfmu.cosim.many.journal import WorkJournal
    from flexfmu.trajectories.table import read_table

    console.check_scene_file(output)
    console.check_file(export, ".csv", "a drive's table")
    drive = {key: value for key, value in (("rate", rate), ("unit", unit), ("counts", counts)) if value is not None}
    if drive and export is None:
        raise InputError(
            f"--{next(iter(drive))} belongs to --export: name its file, --export drive.csv, or leave it out"
        )
    if unit is not None and counts is not None:
        raise InputError(f"--counts {counts:g} gives whole counts, --unit {unit} gives angles in {unit}: leave one out")
    sampling: dict[str, Any] = {"rate": 4000.0, "unit": "rad", "counts": None, **drive}
    check_drive(**sampling)
    if live:
        console.check_page_compiler()
    robot = console.load_changed(scene, settings)
    band = None if payload_band is None else parse_band(payload_band)
    wishes: dict[str, Any] = {
        "minimise": minimise, "duration": duration, "residual": residual, "payload_band": band,
        "stiffness_band": stiffness_band, "damping_band": damping_band, "margin": margin, "corridor": corridor, "seed": seed,
        "cycle.return_payload": return_payload, "cycle.pause": pause, "front": None if front is None else front.split(","),
    }  # fmt: skip
    bands = {} if identified is None else Identification.read(identified).plan_bands(robot)
    robot = with_wishes(robot, bands | {key: value for key, value in wishes.items() if value is not None}, limit or [])
    before = [] if warm_start is None else planned_scenes(warm_start)
    folder = out or console.usual_folder(robot.name, settings, "-plan")
    console.prepared_folder(folder)
    journal = WorkJournal(folder, "plan", about_plan(robot, before), restart=restart, note=console.show_note)
    started = monotonic()
    with console.progress() as show:
        result = plan_scene(
            robot,
            methods=method,
            candidates=[own_candidate(robot, path.name, read_table(path).trajectory()) for path in candidate or ()],
            before=before,
            processes=processes or os.cpu_count() or 1,
            budget=budget,
            robust=robust,
            show=show,
            journal=journal,
        )
        show("writing the results", None)
        files, data, table = write_plan(result, folder), summary(result), None
        if files and output is not None:
            files += write_scene(result, output)
        if files and live:
            from flexfmu.cosim.exchange.live import live_page
            from flexfmu.cosim.many.prepared_scene import run_scene
            from flexfmu.model.scene.file import load_scene

            show("compiling the planned motion for its page", None)
            write_whole(folder / "live.html", live_page(run_scene(load_scene(files[0]))))
            files.append(folder / "live.html")
        if files and export is not None:
            show("the motion as a drive reads it", None)
            table = result.drive_table(**sampling)
            data["drive"] = _drive(table)
            files.append(write_whole(export, table.to_csv()))
            write_whole(folder / "plan.json", to_json(data))
    is_spent = budget is not None and monotonic() - started > budget
    if not result.interrupted:
        journal.remove()
    for message in result.failures:
        console.show_note(message)
    if result.interrupted:
        cause = f"the budget of {budget:g} s is spent" if is_spent else "interrupted"
        console.show_note(f"{cause}: this is the best motion so far" if files else cause)
    if not files:
        console.show_note(f"{folder} keeps the motion of an earlier plan, which isn't worse: no file is written")
    names = [str(path) for path in files]
    console.print_result(
        json,
        {**data, "files": names},
        *(_shown_plan(result) if files else []),
        *([] if table is None else [_shown_drive(table)]),
        f"results: {', '.join(names) or folder}",
    )
    is_missed = bool(result.missed) or (table is not None and not table.use.met)
    return console.FAILURE if is_missed or (result.interrupted and not is_spent) else 0


def _drive(table: DriveTable) -> dict[str, Any]:
    """What the samples for a drive are and leave, as plain data."""
    use = table.use
    found = {"samples": len(table.torque), "rate": table.rate, "unit": table.unit}
    residual = use.value if isfinite(use.value) else None
    return {**found, "residual": residual, "limit": use.limit, "where": use.where, "met": use.met}


def _shown_drive(table: DriveTable) -> str:
    """Whether the samples for a drive keep the limit of the residual vibration."""
    use, remedy = table.use, "--rate" if table.unit != "count" else "--rate or --counts"
    text = f"The table for the drive, {len(table.torque)} samples at {table.rate:g} Hz in {table.unit}"
    if not isfinite(use.value):
        return f"{text}: {use.where}; raise {remedy}."
    text += f", leaves {1e6 * use.value:.3g} {'of' if use.met else 'instead of'} {1e6 * use.limit:.3g} µm of residual vibration ({use.where})"
    return f"{text}." if use.met else f"{text}: raise {remedy}, or plan with less --residual."


def with_wishes(scene: Scene, wishes: dict[str, Any], limits: list[str]) -> Scene:
    """The scene with the wishes of the options in its section `plan`.

    Raises:
        InputError: a limit has another form, or is there twice.
        SceneError: a wish is invalid.
    """
    changes = {f"plan.{key}": value for key, value in wishes.items()}
    for text in limits:
        name, _, value = text.partition("=")
        number, key = value.removesuffix("x"), f"plan.limits.{name.strip()}"
        if key in changes:
            raise InputError(f"--limit has {name.strip()} twice, the second time as {value}: leave one out")
        try:
            changes[key] = value if value == "free" else {"ratio": float(number)} if value != number else float(number)
        except ValueError:
            raise InputError(
                f"--limit takes NAME=VALUE, torque=80 in SI units, torque=1.2x or torque=free; got {text!r}"
            ) from None
    return scene.replace(changes) if changes else scene


SHOWN, SHOWN_FIGURES = 12, ("time", "residual", "power", "energy")
"""Motions of the front that the terminal shows, and what they need, of a front that isn't asked for."""


def _shown_plan(result: PlanResult) -> Iterator[RenderableType]:
    """What the given and the chosen motion need, how close this comes to each limit, the front, the chosen motion in other models, and the verdict."""
    from flexfmu.cosim.design.plans.plan_result import (
        limits_table,
        motions_table,
        robustness_table,
        summary_table,
        ways_table,
    )
    from flexfmu.cosim.reports.terminal import as_terminal_table

    chosen, given = result.chosen, result.given
    faster = "" if chosen is given else f", {chosen.time / given.time:.3g} of the given time"
    yield f"{result.goals.scene.name}: {chosen.candidate.label}: {chosen.time:.4g} s{faster}"
    if chosen is not given:
        yield as_terminal_table(summary_table(result))
    yield from map(as_terminal_table, ways_table(result))
    yield as_terminal_table(limits_table(chosen), texts=("Unit", "Kept", "Where"))
    # motions over the whole front, the given and the chosen one and those to compare with among them; the page has all figures
    motions, front, title = result.table, result.front, "Pareto front"
    count = len(motions)
    if count > SHOWN:
        spread = {round(k * (count - 1) / (SHOWN - 3)) for k in range(SHOWN - 2)}
        always = {chosen, given, *motions} - ({*front} - {chosen, given})
        motions = tuple(each for k, each in enumerate(motions) if k in spread or each in always)
        title += "" if len(motions) == count else f": {len(motions)} of {count}, all in front.csv"
    figures = result.axes if result.goals.wishes.front else SHOWN_FIGURES
    yield as_terminal_table(motions_table(result, title, motions, "", figures, is_brief=True), texts=("Limits",))
    kept = sum(each.feasible for each in result.assessed)
    count = len(result.assessed)
    yield f"Tried: {count} motion{'s' if count != 1 else ''}, {kept} within all limits; all are in plan.html and plan.json."
    for table in robustness_table(result):
        yield as_terminal_table(table, texts=("Model", "Worst for", "Limits"))
    yield f"{result.verdict[0].upper()}{result.verdict[1:]}."
