"""What commands share: exit codes, kinds of arguments, checks before long work, and how a result is presented."""

import math
import os
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, Literal

from tyro.conf import UseAppendAction, arg

from lite6jax.deferred import import_lazily
from lite6jax.errors import InputError, InputWarning, command_line
from lite6jax.storage import check_writable, exists, file_sha256

with import_lazily():
    from lite6jax import recordings
    from lite6jax.arms import description
    from lite6jax.diagnosis import document as diagnosis_file
    from lite6jax.effects import user_effects
    from lite6jax.recordings import settings as sidecar_settings
    from lite6jax.report import documents, figures, screen, words

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import RenderableType
    from rich.text import Text

    from lite6jax.effects.effect import Effect

# ------------------------------------------------------------------ exit codes

DONE = 0
NOT_REACHED = 1
BAD_INPUT = 2
BAD_FIT = 3
# 128 and the number of the signal, as shells count; by their numbers, which Windows lacks in part
HUNG_UP = 129
INTERRUPTED = 130
READER_LEFT = 141
TERMINATED = 143

MEANINGS: Mapping[int, str] = MappingProxyType(
    {
        DONE: "done",
        NOT_REACHED: "done, but the result is not what was asked for: a fit did not converge, a target is out of reach,"
        " a controller does not agree with its calibration, or a recording has fewer rows than asked for",
        BAD_INPUT: "the input cannot be used, or a file cannot be written; one line says which, where and what to do",
        BAD_FIT: "`fit` converged to, or `diagnose` found, a model that does not describe its data;"
        " the files are written and say so",
        HUNG_UP: "ended because its terminal was closed (SIGHUP)",
        INTERRUPTED: "interrupted by Ctrl-C (SIGINT)",
        READER_LEFT: "the program that reads the output, such as head, has ended (SIGPIPE)",
        TERMINATED: "ended by SIGTERM",
    }
)
"""The exit codes of every command; `docs/reference/exit_codes.md` has the same table."""

# ------------------------------------------------------------------ arguments

ArmName = Annotated[str | None, arg(metavar="ARM")]
OutFile = Annotated[Path | None, arg(metavar="FILE")]
Folder = Annotated[Path | None, arg(metavar="DIR")]
Processes = Annotated[int | None, arg(metavar="N")]
Scheduler = Annotated[
    str | None,
    arg(
        metavar="ADDRESS",
        help="In place of processes of this machine: the Dask cluster of the scheduler at this address "
        "(tcp://HOST:8786).",
    ),
]
OwnEffects = Annotated[
    Path | None, arg(metavar="FILE.py", help="Effects of your own that the model has. Runs the file.")
]
Json = Annotated[bool, arg(help="Print JSON instead of the report.")]
Force = Annotated[bool, arg(help="Replace files that exist.")]
AssumeDegrees = Annotated[bool, arg(help="Take joint columns that say rad as degrees.")]
AssumeMillimetres = Annotated[bool, arg(help="Take position columns that say m as millimetres.")]
Seed = Annotated[int, arg(help="Seed of the random numbers.")]
Duration = Annotated[float | None, arg(metavar="S", help="The duration; by default until Ctrl-C.")]
Known = Literal["known", "unknown"]
Geometry = Literal["declared", "exact", "prior", "free"]
EffectTexts = Annotated[tuple[str, ...], UseAppendAction, arg(metavar="NAME:KEY=VALUE,…")]
Triple = Annotated[tuple[float, float, float], arg(metavar="X Y Z")]


def parse_pairs(option: str, given: tuple[str, ...], as_yaml: bool = False) -> dict[str, Any]:
    """`name=value` by name; values are text, or what YAML reads. Refuses what is no such pair, by the option."""
    import yaml

    values: dict[str, Any] = {}
    for pair in given:
        name, mark, value = pair.partition("=") if as_yaml else pair.rpartition("=")
        if not mark or not name or not value or len(pair) > 1000:
            raise InputError(f"{option} {pair[:60]}: write it as {'KEY=VALUE' if as_yaml else 'COLUMN=MEANING'}")
        try:
            values[name] = yaml.safe_load(value) if as_yaml else value
        except yaml.YAMLError as error:
            raise InputError(f"{option} {pair[:60]}: its value is not valid YAML; write KEY=VALUE") from error
    return values


def assumptions(options: Any) -> dict[str, bool]:
    """What a command takes the units of a recording for, as readers want it."""
    return {"assume_degrees": options.assume_degrees, "assume_millimetres": options.assume_millimetres}


def load_own_effects(file: Path | None) -> "tuple[Effect, ...]":
    """The effects in a user's file; none where none is given."""
    return () if file is None else user_effects.load_effects(file)


def name_arm(arm: str, file: Path) -> str:
    """How a sidecar, or what stands in its folder, names an arm: a bundled one by its name, a file by its relative
    path."""
    if arm in description.bundled_arms():
        return arm
    return relative_path(arm, file)


def relative_path(path: str | Path, file: Path) -> str:
    """A path relative to the folder of a file, as a sidecar has it."""
    return Path(os.path.relpath(Path(path).resolve(), file.resolve().parent)).as_posix()


def stem(source: str) -> str:
    """The name of an arm, or of its file without folder, suffix and tip: figures are named after it."""
    return Path(source.partition("#")[0]).stem


def metres(point: tuple[float, float, float]) -> tuple[float, float, float]:
    """A point in mm as one in m."""
    x, y, z = point
    return x / 1e3, y / 1e3, z / 1e3


# ------------------------------------------------------------------ the files that a diagnosis was made from


def list_inputs(
    recording: Path, arm: str | None = None, reference: Path | None = None, effects: Path | None = None
) -> list[dict[str, str]]:
    """Each file by its role, name and SHA-256: recordings, their sidecars, the files that these name, and of
    effects."""
    files = []
    for role, file in (("", recording), ("reference ", reference)):
        if file is not None:
            parts = [("recording", file), *sidecar_settings.list_sidecar_files(file)]
            files += [(f"{role}{part}", path) for part, path in parts]
    files += [("arm", Path(arm.partition("#")[0]))] if arm else []
    files += [("effects", effects)] if effects else []
    files = [(role, file) for role, file in dict.fromkeys(files) if file.is_file()]
    return [{"role": role, "file": file.name, "sha256": file_sha256(file)} for role, file in files]


def find_recording(document: Mapping[str, Any], diagnosis: Path) -> Path | None:
    """The recording that was diagnosed, where it is beside the diagnosis or here."""
    file_names = [entry["file"] for entry in _recordings(document)]
    places = [place for file in file_names for place in (diagnosis.with_name(file), Path(file))]
    return next((place for place in places if place.is_file()), None)


def require_recording(document: Mapping[str, Any], diagnosis: Path) -> Path:
    """The recording that was diagnosed; warns where the file is another one, and refuses where there is none."""
    entries = _recordings(document)
    recording_path = find_recording(document, diagnosis)
    if recording_path is None:
        reason = (
            f"the recording {entries[0]['file']} that it names is not beside it" if entries else "it names no recording"
        )
        raise InputError(f"{diagnosis}: {reason}; give one: {command_line('view', diagnosis, 'RECORDING')}")
    if file_sha256(recording_path) != entries[0]["sha256"]:
        message = f"{recording_path}: is not as it was when {diagnosis.name} was made from it (their SHA-256 differ)"
        warnings.warn(message, InputWarning, stacklevel=2)
    return recording_path


def find_nominal(document: Mapping[str, Any], diagnosis: Path) -> str | None:
    """The file of the nominal arm, with base and tip, that the sidecar of the diagnosed recording names.

    None where the sidecar is not beside the diagnosis or here, names a bundled arm, or the file is not as it was.
    """
    sums = {entry["sha256"] for entry in document.get("inputs", ()) if entry["role"] in ("arm", "simulator")}
    recording = find_recording(document, diagnosis)
    declared = None
    if recording is not None:
        declared = sidecar_settings.sidecar_path(recording)
    if declared is None or not sums or not exists(declared):
        return None
    settings = sidecar_settings.read_settings(declared)
    reference = ""
    if settings.arm_is_file:
        reference = str(settings.arm_reference(declared.parent))
    file = Path(reference.partition("#")[0])
    if reference and file.is_file() and file_sha256(file) in sums:
        return reference
    return None


def _recordings(document: Mapping[str, Any]) -> list[Mapping[str, str]]:
    return [entry for entry in document.get("inputs", ()) if entry["role"] == "recording"]


@contextmanager
def refuse_damage(diagnosis: Path) -> Iterator[None]:
    """Within, what a document lacks is an error of the input."""
    try:
        yield
    except InputError:
        raise
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        raise InputError(f"{diagnosis}: is damaged (it lacks {error}); {diagnosis_file.DAMAGED}") from error


# ------------------------------------------------------------------ checks


def check_outputs(
    outputs: Sequence[Path | None], inputs: Iterable[str | Path | None], overwrite: bool, suffixes: Sequence[str] = ()
) -> None:
    """Refuses outputs before long work; one that is an input is not replaced, which --force does not ask for.

    Inputs are files or names of bundled arms, as given; of a recording the sidecar and the files that it names too.
    Outputs may have any suffix where there are no `suffixes`.

    Raises:
        InputError: another suffix, a file that exists or cannot be written, an input, or a sidecar cannot be read.
    """
    for path, suffix in zip(outputs, suffixes, strict=False):
        if path is not None and path.suffix.lower() != suffix:
            raise InputError(f"{path}: what is written here is {suffix[1:]}; let the name end in {suffix}")
    files = [check_writable(path, overwrite) for path in outputs if path is not None]
    read = [file for source in inputs if source is not None for file in _files_read(source) if os.path.exists(file)]
    for path in files:
        if os.path.exists(path) and any(os.path.samefile(path, file) for file in read):
            raise InputError(f"{path}: is read by this command and would be replaced; choose another name to write to")


def _files_read(source: str | Path) -> Iterator[Path]:
    yield Path(source)
    yield Path(str(source).partition("#")[0])
    file = recordings.recording_file(source)
    if file is not None:
        yield from (path for _, path in sidecar_settings.list_sidecar_files(file))


def check_seed(seed: int) -> None:
    """Refuses a negative seed, which NumPy's generators do not take."""
    if seed < 0:
        raise InputError(f"--seed {seed}: give 0 or more")


def check_duration(seconds: float | None) -> None:
    """Refuses a duration that is not above 0."""
    if seconds is not None and not 0 < seconds < math.inf:
        raise InputError(f"--duration {seconds}: give seconds above 0")


def check_processes(processes: int | None, scheduler: str | None) -> None:
    """Refuses no processes, and processes of this machine beside a cluster."""
    if processes is not None and processes < 1:
        raise InputError(f"--processes {processes}: give 1 or more")
    if processes is not None and scheduler is not None:
        raise InputError("--processes and --scheduler: give one of them; a cluster has workers of its own")


def check_figures(folder: Path | None, names: Sequence[str], overwrite: bool) -> None:
    """Refuses figures that cannot be written where they are asked for, if they are."""
    if folder is not None:
        figures.check_names(folder, names, overwrite)


# ------------------------------------------------------------------ results


def save_figures(
    folder: Path | None, names: Sequence[str], draw: "Callable[[], Iterable[Figure]]", overwrite: bool
) -> list[Path]:
    """Draws figures and writes them by these names, as far as there are some, where a folder is given."""
    if folder is None:
        return []
    return figures.save(dict(zip(names, draw(), strict=False)), folder, overwrite)


def present(
    as_json: bool, result: Any, report: "Iterable[RenderableType]", written: Sequence[Path] = (), code: int = DONE
) -> int:
    """Prints the document of a result, or its report and the files that were written, and returns the exit code.

    Files are written before: a reader who leaves early, like `head`, must not cost them. A result is a document or its
    text, has one, or returns one.
    """
    if as_json:
        document = result() if callable(result) else result
        if not isinstance(document, str):
            document = documents.text(
                document if isinstance(document, Mapping) else documents.document(document), written
            )
        print(document)
        return code
    screen.show(report)
    screen.written(written)
    return code


def say(text: str, **facts: object) -> "Iterator[Text]":
    """What a command says of its work: the sentences of `templates/commands.yaml` by this name, a line each."""
    from rich.text import Text

    for template in words.read_texts("commands.yaml")[text]:
        if (line := words.fill(template, facts)) or not template:
            yield Text(line)


def list_effects(effects: "Iterable[tuple[Any, Mapping[str, Any]]]") -> "Iterator[Text]":
    """A line for each effect with its numbers."""
    from rich.text import Text

    for effect, parameters in effects:
        numbers = ", ".join(f"{name} = {estimate.value:.6g}" for name, estimate in parameters.items())
        yield Text(f"  {effect.name} at {effect.site}: {numbers}")


def repeat(duration: float | None, every: float) -> Iterator[None]:
    """Goes on every so many seconds until the duration is over; for ever where none is given."""
    end = math.inf if duration is None else time.monotonic() + duration
    while (remaining := end - time.monotonic()) > 0:
        yield
        time.sleep(min(every, remaining))
