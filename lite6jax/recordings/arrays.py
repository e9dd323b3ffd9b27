"""From named arrays, as files of HDF5, NumPy and MATLAB and documents of JSON and YAML hold them, to columns.

The samples are along the axis whose length most arrays share. Pairs of a robot's pose and a target's, as hand-eye
calibrations take them, become the columns of two poses.
"""

import re
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import scipy  # whose parts are imported where they are first used: `spatial` takes half a second

from lite6jax.array_types import AnyArray
from lite6jax.errors import InputError
from lite6jax.formatting import shortened
from lite6jax.recordings.table import RawTable

WIDEST = 64
"""Numbers of a sample in one array that are a column each; more, such as pictures, are none."""
LARGEST = 50_000_000
"""Numbers that are read of one file, 0.4 GB."""
_MATRICES = ((3, 3), (3, 4), (4, 4))
_OF_ONE_SAMPLE = (*_MATRICES, (3, 1), (1, 3))
_NUMBERED = re.compile(r"(.*?)[_.]?(\d+)")
_SHOWN = 4


def tabulate_arrays(arrays: Mapping[str, AnyArray], source: str, notes: list[str]) -> RawTable:
    """The columns of named arrays: `q[0]`, `q[1]` of `(sample, 2)`, `T[0][0]` of `(sample, 4, 4)`.

    Args:
        arrays: by their names, whose parts are separated by points.
        source: what messages begin with.
        notes: gets a sentence on what is left out, turned or paired.

    Raises:
        InputError: no array of numbers with samples.
    """
    arrays = _stack_numbered({name: _plain(array) for name, array in arrays.items()})
    arrays = {name: array for name, array in arrays.items() if array.ndim and array.size}
    samples = _count_samples(arrays)
    if not samples:
        raise InputError(f"{source}: holds no arrays of numbers with a row for each sample; write it as CSV")
    labels = {name: array for name, array in arrays.items() if array.dtype.kind == "U"}
    numbers = {name: array for name, array in arrays.items() if array.dtype.kind == "f"}
    lined_up = {name: _samples_first(array, samples) for name, array in numbers.items()}
    left_out = [name for name, array in lined_up.items() if array is None or array[0].size > WIDEST]
    sampled_arrays = {name: array for name, array in lined_up.items() if array is not None and name not in left_out}
    columns: dict[str, AnyArray] = {}
    for name, array in pair_poses(sampled_arrays, notes).items():
        columns |= dict(_columns(name, array, _element_names(labels, name, array)))
    columns |= {name: array.astype(object) for name, array in labels.items() if array.shape == (samples,)}
    if left_out:
        shapes = [f"{name} ({' x '.join(map(str, numbers[name].shape))})" for name in left_out]
        notes.append(f"left out, as they are no columns of {samples} rows: {shortened(shapes, _SHOWN)}")
    if not columns:
        raise InputError(f"{source}: holds no arrays of numbers with a row for each sample; write it as CSV")
    return RawTable.of_arrays(columns)


def _plain(array: AnyArray) -> AnyArray:
    """Numbers as float64, words as text, and nothing of all else."""
    if array.dtype.kind in "biuf":
        return array.astype(np.float64)
    if array.dtype.kind in "US":
        return array.astype(str)
    if array.dtype.kind == "O" and array.size and all(isinstance(word, str | bytes) for word in array.ravel()):
        return np.array(
            [word.decode("utf-8", "replace") if isinstance(word, bytes) else word for word in array.ravel()]
        )
    return np.zeros(0)


def _stack_numbered(arrays: Mapping[str, AnyArray]) -> dict[str, AnyArray]:
    """Matrices of single samples, such as `R_0`, `R_1`, …, as one array."""
    groups: defaultdict[tuple[str, tuple[int, ...]], dict[int, str]] = defaultdict(dict)
    for name, array in arrays.items():
        match = _NUMBERED.fullmatch(name)
        if match and array.shape in _OF_ONE_SAMPLE:
            groups[match[1], array.shape][int(match[2])] = name
    stacked = dict(arrays)
    for (name, _), members in groups.items():
        if len(members) < 3:  # one matrix beside another is no sample
            continue
        for member in members.values():
            del stacked[member]
        stacked[name] = np.stack([arrays[members[number]] for number in sorted(members)])
    return stacked


def _count_samples(arrays: Mapping[str, AnyArray]) -> int:
    """The length that most arrays of numbers have along some axis, of several the longest."""
    counts: Counter[int] = Counter()
    for array in arrays.values():
        if array.dtype.kind == "f":
            counts.update({*array.shape})
    return max(counts, key=lambda length: (counts[length], length), default=0)


def _samples_first(array: AnyArray, samples: int) -> AnyArray | None:
    """`(sample, …)` with axes of length one removed; None of an array without an axis of samples."""
    axis = next((k for k, length in enumerate(array.shape) if length == samples), None)
    if axis is None:
        return None
    array = np.moveaxis(array, axis, 0)
    return array.reshape(samples, *(length for length in array.shape[1:] if length != 1))


def _element_names(labels: Mapping[str, AnyArray], name: str, array: AnyArray) -> Sequence[str]:
    """What the numbers of a sample are called, by a list of as many names beside the array; none without it."""
    beside = name.rpartition(".")[0]
    if array.ndim != 2:
        return ()
    return next(
        (
            names.tolist()
            for key, names in labels.items()
            if "name" in key.rpartition(".")[2] and key.rpartition(".")[0] == beside and names.shape == array.shape[1:]
        ),
        (),
    )


def _columns(name: str, array: AnyArray, elements: Sequence[str]) -> Iterator[tuple[str, AnyArray]]:
    """The columns of `(sample, …)`, by their names."""
    if array.ndim == 1:
        yield name, array
        return
    for place in np.ndindex(array.shape[1:]):
        column = array[(slice(None), *place)]
        if elements:
            yield f"{name}.{elements[place[0]]}", column
        elif array.ndim == 2 or array.shape[1:] in _MATRICES:
            yield name + "".join(f"[{k}]" for k in place), column
        else:  # such as the poses of two hands
            yield "_".join([name, *map(str, place[:-1])]) + f"[{place[-1]}]", column


# ------------------------------------------------------------------ pairs of poses

_HAND = "gripper|hand|eef?|end_?effector|effector|flange|tool|tcp|end"
_BASE = "robot_?base|base|world|robot"
_TARGET = "target|object|board|marker|tag|pattern|chessboard|checkerboard|aruco|charuco|cal"
_CAMERA = "camera|cam|sensor|optical|tracker"
_IN = "2|_?to_?|_?wrt_?|_in_"
_SIDES = {
    "robot": (_HAND, _BASE),
    "marker": (_TARGET, _CAMERA),
}
_WORDS = {
    "robot": r"(?:^|[.])(?:robot|hand_world\w*)(?:[.]|$)",
    "marker": r"(?:^|[.])(?:tracking|optical|camera_marker\w*)(?:[.]|$)",
}
_PARTS = {
    "turn": re.compile(r"(^|[._])(r|rot|rotations?|rvecs?|rmat|orientation|quaternion)([._]|$)", re.IGNORECASE),
    "shift": re.compile(r"(^|[._])(t|trans|translations?|tvecs?|position)([._]|$)"),
}


class _Part(NamedTuple):
    """What an array is of a hand-eye pair: whose pose, whether inverted, and which part of it."""

    side: str
    inverted: bool
    part: str


def pair_poses(arrays: Mapping[str, AnyArray], notes: list[str]) -> dict[str, AnyArray]:
    """Arrays, with pairs of poses of a hand-eye calibration as positions and quaternions of `robot` and `marker`.

    The layouts are those of OpenCV's `calibrateHandEye` (`R_gripper2base`, `t_target2cam`), MoveIt's calibration
    (`effector_wrt_world`, `object_wrt_sensor`) and easy_handeye (`robot`, `tracking`). An inverted pose, such as
    `base2gripper`, is turned back.
    """
    parts = {name: part for name in arrays if (part := _part_of(name)) is not None}
    poses = {side: _pose(arrays, {n: p for n, p in parts.items() if p.side == side}) for side in _SIDES}
    if any(pose is None for pose in poses.values()):
        return dict(arrays)
    columns = {name: array for name, array in arrays.items() if name not in parts}
    for side, T in poses.items():
        assert T is not None
        columns |= {f"{side}_{axis}": T[:, k, 3] for k, axis in enumerate("xyz")}
        quaternion = scipy.spatial.transform.Rotation.from_matrix(T[:, :3, :3]).as_quat(
            scalar_first=True, canonical=True
        )
        columns |= {f"{side}_q{part}": column for part, column in zip("wxyz", quaternion.T, strict=True)}
    inverted = [name for name, part in parts.items() if part.inverted]
    turned = f"; {', '.join(inverted[:2])} are turned back" if inverted else ""
    notes.append(f"{', '.join(list(parts)[:_SHOWN])} are pairs of a robot's pose and a target's{turned}")
    return columns


def _part_of(name: str) -> _Part | None:
    """What an array is of a hand-eye pair by its name; None of all others."""
    text = name.lower()
    part = next((part for part, pattern in _PARTS.items() if pattern.search(name)), "whole")
    for side, (moved, fixed) in _SIDES.items():
        for inverted, (first, second) in ((False, (moved, fixed)), (True, (fixed, moved))):
            of_phrase = rf"(?:^|[._])(?:{first})(?:{_IN})(?:{second})(?:$|[._])"
            of_matrix = rf"(?:^|[._])(?:t_(?:{second})_(?:{first})|(?:{second})_t_(?:{first}))(?:$|[._])"
            if re.search(of_phrase, text):
                return _Part(side, inverted, part)
            if re.search(of_matrix, text):
                return _Part(side, inverted, "whole")
        if re.search(_WORDS[side], text):
            return _Part(side, False, part)
    return None


def _pose(arrays: Mapping[str, AnyArray], parts: Mapping[str, _Part]) -> AnyArray | None:
    """`(sample, 4, 4)` of one side of a pair; None where its arrays are no pose."""
    if not parts or len({part.inverted for part in parts.values()}) > 1:
        return None
    of_part = {
        kind: {name: arrays[name] for name, part in parts.items() if part.part == kind}
        for kind in ("whole", "turn", "shift")
    }
    if of_part["whole"]:
        if len(of_part["whole"]) > 1:
            return None
        (matrices,) = of_part["whole"].values()
        if matrices[0].size != 16:
            return None
        T = matrices.reshape(-1, 4, 4)
        T = np.swapaxes(T, 1, 2) if np.allclose(T[:, :3, 3], 0) and not np.allclose(T[:, 3, :3], 0) else T
    else:
        turn = _rotations(of_part["turn"])
        shift = _joined(of_part["shift"], "xyz")
        if turn is None or shift is None:
            return None
        T = np.tile(np.eye(4), (len(shift), 1, 1))
        T[:, :3, :3], T[:, :3, 3] = turn, shift
    if not np.allclose(T[:, :3, :3] @ np.swapaxes(T[:, :3, :3], 1, 2), np.eye(3), atol=0.01):
        return None
    (inverted,) = {part.inverted for part in parts.values()}
    return np.linalg.inv(T) if inverted else T


def _rotations(arrays: Mapping[str, AnyArray]) -> AnyArray | None:
    """`(sample, 3, 3)` of matrices, rotation vectors, or quaternions by the names of their parts."""
    quaternion = _joined(arrays, "xyzw")
    if quaternion is not None:
        return (
            None if not quaternion.any(1).all() else scipy.spatial.transform.Rotation.from_quat(quaternion).as_matrix()
        )
    if len(arrays) != 1:
        return None
    (array,) = arrays.values()
    if array.shape[1:] == (3, 3):
        return array
    return scipy.spatial.transform.Rotation.from_rotvec(array).as_matrix() if array.shape[1:] == (3,) else None


def _joined(arrays: Mapping[str, AnyArray], letters: str) -> AnyArray | None:
    """`(sample, letter)` of one array, or of one for each letter, with which their names end; None of others."""
    if len(arrays) == 1 and letters == "xyz":
        (array,) = arrays.values()
        return array if array.shape[1:] == (3,) else None
    of_letter = {name.rpartition(".")[2]: array for name, array in arrays.items()}
    if {*of_letter} != {*letters} or any(array.ndim != 1 for array in of_letter.values()):
        return None
    return np.stack([of_letter[letter] for letter in letters], 1)
