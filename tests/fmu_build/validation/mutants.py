"""A sound FMU, and mutants of it: each is spoilt in one respect, in its archive, its description or its behaviour."""

from __future__ import annotations

import io
import re
import struct
import subprocess
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from flexfmu.fmu_build.toolchain import find_compiler, fmi_header_folder, native_platform

SOURCES = Path(__file__).parent / "spring-fmu"
DESCRIPTION = "modelDescription.xml"
LIBRARY = "binaries/linux64/spring.so"

Files = dict[str, bytes]

STRICT = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-O1", "-fPIC", "-shared")


def compile_spring(folder: Path, *flags: str, source: str = "spring.c") -> bytes:
    """The library, with further compiler flags."""
    library = folder / "spring.so"
    compiler = find_compiler(native_platform()).command
    files = [f"-I{fmi_header_folder()}", str(SOURCES / source), "-o", str(library), "-lm"]
    subprocess.run([*compiler, *STRICT, *files, *flags], check=True)
    return library.read_bytes()


def spring_files(library: bytes) -> Files:
    """Files of the sound FMU."""
    return {
        DESCRIPTION: (SOURCES / DESCRIPTION).read_bytes(),
        LIBRARY: library,
        "sources/spring.c": (SOURCES / "spring.c").read_bytes(),
    }


def spring3(library: bytes, mutant: str = "sound") -> bytes:
    """The archive of the FMU of FMI 3.0, or of a mutant of its behaviour."""
    description = (SOURCES / "modelDescription3.xml").read_bytes()
    path = "binaries/x86_64-linux/spring.so"
    return zipped({DESCRIPTION: description, path: library, "resources/mutant.txt": mutant.encode()})


def zipped(
    content: Files, finish: Callable[[zipfile.ZipFile], None] = lambda archive: None, method: int = zipfile.ZIP_DEFLATED
) -> bytes:
    """An archive, to which ``finish`` adds what no file is."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", method, compresslevel=1) as archive:
        for name, data in content.items():
            archive.writestr(name, data)
        finish(archive)
    return stream.getvalue()


@dataclass(frozen=True)
class Mutant:
    """An FMU spoilt in one respect.

    Attributes:
        name: what is spoilt.
        part: ``archive``, ``description`` or ``behaviour``.
        make: the archive, from the files of the sound FMU.
        runs: whether the FMU has to run to show it.
    """

    name: str
    part: str
    make: Callable[[Files], bytes]
    runs: bool = False


def behaves(name: str) -> Mutant:
    """A mutant by the name that the library reads in its resources."""

    def make(sound: Files) -> bytes:
        description = sound[DESCRIPTION]
        if name not in ("addresses", "serialises_beyond"):  # saves a process
            description = description.replace(b' canSerializeFMUstate="true"', b"")
        if name.startswith("pending_"):
            description = description.replace(b"<CoSimulation ", b'<CoSimulation canRunAsynchronuously="true" ')
        return zipped(sound | {DESCRIPTION: description, "resources/mutant.txt": name.encode()})

    return Mutant(name, "behaviour", make, runs=True)


def described(name: str, *changes: tuple[str, str], runs: bool = False) -> Mutant:
    """A mutant by changes of the model description, each old text to be there."""

    def make(sound: Files) -> bytes:
        text = sound[DESCRIPTION].decode()
        for old, new in changes:
            assert old in text, f"{old} is not in the description of the sound FMU"
            text = text.replace(old, new)
        return zipped(sound | {DESCRIPTION: text.encode()})

    return Mutant(name, "description", make, runs)


def rezipped(name: str, finish: Callable[[zipfile.ZipFile], None]) -> Mutant:
    """A mutant by an entry that no sound archive has."""
    return Mutant(name, "archive", lambda sound: zipped(sound, finish))


def _twice(archive: zipfile.ZipFile) -> None:
    archive.writestr("resources/data.txt", b"1")
    archive.filelist.append(archive.filelist[-1])


def _link(archive: zipfile.ZipFile) -> None:
    entry = zipfile.ZipInfo("resources/link.txt")
    entry.external_attr = 0o120777 << 16
    archive.writestr(entry, b"/etc/passwd")


def _entry(name: str) -> Callable[[zipfile.ZipFile], None]:
    def write(archive: zipfile.ZipFile) -> None:
        entry = zipfile.ZipInfo("x")
        entry.filename = entry.orig_filename = name
        archive.writestr(entry, b"x")

    return write


def _damaged(sound: Files) -> bytes:
    content = bytearray(zipped(sound))
    at = content.find(b"sources/spring.c") + 2000
    content[at : at + 20] = bytes(20)
    return bytes(content)


def _marked_as_encrypted(sound: Files) -> bytes:
    content = bytearray(zipped(sound))
    content[6] |= 1
    return bytes(content)


SOUND = {"sound", "ends_early", "once", "counts", "asynchronous", "offset", "ticks", "crash_wanders"}
BEHAVIOUR = [
    behaves(name)
    for name in re.findall(r"\bX\((\w+)\)", (SOURCES / "spring.c").read_text(encoding="utf-8"))
    if name not in SOUND
]
"""What the library knows but for the sound variants and one that is tried apart."""

DESCRIPTION_CHANGES = r"""
guid empty => guid="{spring}" -> guid=""
guid of another build* => {spring} -> {other}
min above max => min="-1" max="1" -> min="1" max="-1"
start beyond max => max="1" start="0" -> max="1" start="2"
start is NaN => start="40" -> start="NaN"
start is text => start="40" -> start="soft"
start missing => max="10" start="0.1" -> max="10"
start of a calculated => <Real unit="rad/s"/> -> <Real unit="rad/s" start="6"/>
start of the time => "continuous">\n      <Real/> -> "continuous">\n      <Real start="0"/>
initial of an input => name="pull" -> name="pull" initial="exact"
nominal 0 => min="0" start="0.5" -> min="0" nominal="0" start="0.5"
parameter varies => "7" causality="parameter" variability="tunable" -> "7" causality="parameter" variability="continuous"
Boolean varies continuously => variability="discrete" -> variability="continuous"
name twice => name="velocity" -> name="position"
name with a line feed => name="velocity" -> name="velo&#10;city"
value reference of two parameters => name="damping" valueReference="7" -> name="damping" valueReference="6"
value reference of two units => name="force" valueReference="5" -> name="force" valueReference="1"
value references exchanged* => name="position" valueReference="1" -> name="position" valueReference="2"
=> name="velocity" valueReference="2" -> name="velocity" valueReference="1"
unit's exponent => <BaseUnit kg="1" s="-2"/> -> <BaseUnit kg="1" m="1" s="-2"/>
unit's factor => <BaseUnit m="1" s="-1"/> -> <BaseUnit m="1" s="-1" factor="3.6"/>
display unit's factor => name="mm" factor="1000" -> name="mm" factor="0.001"
unit missing => <Unit name="N">\n      <BaseUnit kg="1" m="1" s="-2"/>\n    </Unit> ->
unit twice => <Unit name="rad/s"> -> <Unit name="N"><BaseUnit kg="1" m="1" s="-2"/></Unit>\n    <Unit name="rad/s">
type missing => declaredType="Material" -> declaredType="Metal"
enumeration starts with no item => declaredType="Material" start="1" -> declaredType="Material" start="3"
items of one value => name="rubber" value="2" -> name="rubber" value="1"
output not listed => <Unknown index="6" dependencies="1 2"/>\n ->
output listed twice => <Outputs> -> <Outputs><Unknown index="6" dependencies="1 2"/>
unknown out of range => <Unknown index="14"/>\n    </Outputs> -> <Unknown index="40"/>\n    </Outputs>
dependency out of range => dependencies="1 2"/> -> dependencies="1 20"/>
dependenciesKind too short => "fixed fixed fixed" -> "fixed fixed"
initial unknown missing => <Unknown index="9" dependencies="7"/> ->
derivative of itself => derivative="2" -> derivative="4"
derivatives of one state => derivative="3" -> derivative="2"
derivatives exchanged* => derivative="2" -> derivative="X"
=> derivative="3" -> derivative="2"
=> derivative="X" -> derivative="3"
dependency not declared* => <Unknown index="6" dependencies="1 2"/>\n -> <Unknown index="6" dependencies="1"/>\n
experiment ends before it begins => stopTime="1" -> stopTime="-1"
step of 0 => stepSize="0.02" -> stepSize="0"
step longer than the experiment => stepSize="0.02" -> stepSize="20"
identifier is no C name => CoSimulation modelIdentifier="spring" -> CoSimulation modelIdentifier="my-spring"
no interface => <ModelExchange -> <!--
=> </CoSimulation> -> -->
serialises what it can't save => maxOutputDerivativeOrder="1" canGetAndSetFMUstate="true" -> maxOutputDerivativeOrder="1"
second output derivatives* => maxOutputDerivativeOrder="1" -> maxOutputDerivativeOrder="2"
unknown element => Outputs> -> Outptus>
attribute missing => valueReference="8" ->
not well-formed => </ModelStructure> ->
another version => fmiVersion="2.0" -> fmiVersion="2.1"
no date => 2026-11-22T12:00:00Z -> yesterday
two times => </ModelVariables> -> <ScalarVariable name="clock" valueReference="9" CLOCK</ModelVariables>
=> CLOCK -> causality="independent" variability="continuous"><Real/></ScalarVariable>
name empty => name="damping" -> name=""
derivative starts anew => derivative="3" -> derivative="3" reinit="true"
document type => <fmiModelDescription -> <!DOCTYPE spring [<!ENTITY x "y">]>\n<fmiModelDescription
local beyond max* => <Real unit="m/s" start="0"/> -> <Real unit="m/s" max="1" start="0"/>
=> <Real unit="m/s" derivative="2"/> -> <Real unit="m/s" min="1" derivative="2"/>
"""
"""Name, a star where it has to run, and what replaces what; a row that begins with => goes on with the one before."""

DESCRIPTIONS = []
for row in re.split(r"\n(?!=>)", DESCRIPTION_CHANGES.strip()):
    name, *changes = re.split(r"\s*=> ", row)
    replacements = [change.replace("\\n", "\n").partition(" ->") for change in changes]
    DESCRIPTIONS.append(
        described(name.rstrip("*"), *((old, new[1:]) for old, _, new in replacements), runs=name.endswith("*"))
    )

ADDED = {
    "DLL of another name": {"binaries/win64/other.dll": b"MZ"},
    "DLL is text": {"binaries/win64/spring.dll": b"text"},
    "folder of no platform": {"binaries/linux/spring.so": b"text"},
    "source empty": {"sources/spring.c": b""},
    "source does not compile": {"sources/spring.c": b"int fmi2GetReal(void) { return x; }"},
    "documentation without a start": {"documentation/other.html": b"x"},
    "picture is text": {"model.png": b"x"},
    "folder in capitals": {"Resources/data.txt": b"1"},
    "file where no tool looks": {"data.txt": b"1"},
    "binary is text": {LIBRARY: b"#!/bin/sh\n"},
}
MOVED = {
    "no binary": (LIBRARY, ""),
    "binary of another name": (LIBRARY, "binaries/linux64/other.so"),
    "source missing": ("sources/spring.c", ""),
    "description in a folder": (DESCRIPTION, f"spring/{DESCRIPTION}"),
}


def moved(sound: Files, old: str, new: str) -> bytes:
    """The archive with a file elsewhere, or without it."""
    content = {name: data for name, data in sound.items() if name != old}
    return zipped(content | ({new: sound[old]} if new else {}))


def spoilt(name: str, change: Callable[[bytes], bytes]) -> Mutant:
    """A mutant by a change of its library."""
    return Mutant(name, "archive", lambda sound: zipped(sound | {LIBRARY: change(sound[LIBRARY])}))


ARCHIVE = [
    *(Mutant(name, "archive", lambda sound, files=files: zipped(sound | files)) for name, files in ADDED.items()),
    *(Mutant(name, "archive", lambda sound, way=way: moved(sound, *way)) for name, way in MOVED.items()),
    spoilt("binary is cut off", lambda library: library[:4000]),
    spoilt("binary for another processor", lambda library: library[:18] + struct.pack("<H", 183) + library[20:]),
    spoilt("function missing", lambda library: library.replace(b"fmi2CancelStep\0", b"fmi2CancelStop\0")),
    rezipped("path with a backslash", _entry("resources\\data.txt")),
    rezipped("path out of the folder", _entry("../data.txt")),
    rezipped("absolute path", _entry("/tmp/data.txt")),
    rezipped("file twice", _twice),
    rezipped("symbolic link", _link),
    Mutant("packed by LZMA", "archive", lambda sound: zipped(sound, method=zipfile.ZIP_LZMA)),
    Mutant("damaged", "archive", _damaged),
    Mutant("marked as encrypted", "archive", _marked_as_encrypted),
    Mutant("cut off", "archive", lambda sound: zipped(sound)[:-400]),
    Mutant("no archive", "archive", lambda sound: sound[LIBRARY]),
]


def without_exchange(description: bytes) -> bytes:
    """The description with co-simulation alone."""
    return re.sub(rb"<ModelExchange.*?</ModelExchange>", b"", description, flags=re.DOTALL)


def _without_exchange(sound: Files) -> bytes:
    description = without_exchange(sound[DESCRIPTION])
    return zipped(sound | {DESCRIPTION: description, "resources/mutant.txt": b"undeclared_state"})


BEHAVIOUR.append(Mutant("state not declared, no model exchange", "behaviour", _without_exchange, runs=True))

MUTANTS = [*ARCHIVE, *DESCRIPTIONS, *BEHAVIOUR]


def sound_variants(library: bytes) -> dict[str, bytes]:
    """FMUs that are sound: as it is, one that ends the simulation by itself, one that a process may have once, one whose steps
    go on after fmi2DoStep has returned."""
    sound = spring_files(library)
    once = re.sub(
        rb"(<(CoSimulation|ModelExchange)) ", rb'\1 canBeInstantiatedOnlyOncePerProcess="true" ', sound[DESCRIPTION]
    )
    asynchronous = sound[DESCRIPTION].replace(b"<CoSimulation ", b'<CoSimulation canRunAsynchronuously="true" ')
    return {
        "sound": zipped(sound),
        "runs asynchronously": zipped(sound | {DESCRIPTION: asynchronous, "resources/mutant.txt": b"asynchronous"}),
        "large output": zipped(sound | {"resources/mutant.txt": b"offset"}),
        "time events": zipped(sound | {"resources/mutant.txt": b"ticks"}),
        "ends the simulation": zipped(sound | {"resources/mutant.txt": b"ends_early"}),
        "once a process": zipped(sound | {DESCRIPTION: without_exchange(once), "resources/mutant.txt": b"once"}),
    }
