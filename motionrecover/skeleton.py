"""Skeletons: named joints tied by bones of constant length, as a tree or as any graph."""

from __future__ import annotations

import re
import tomllib
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import UnionType

import numpy as np

from motionrecover.standards import STANDARDS, table

ZERO_LENGTH = 1e-6
"""Bones shorter than this (metres) have no direction: their two joints are one joint to the solver."""

FARTHEST = 1e9
"""Metres, beyond the Moon. Coordinates above come of damaged files or wrong units, and overflow when multiplied."""


@dataclass(frozen=True)
class Skeleton:
    """Joints and the bones between them.

    `names` are the joints. `edges` are the bones as pairs (parent, child) of joint indices or names; in a general
    graph (a marker cloud) the order inside a pair means nothing. `rest_offsets`, shape (joint, 3) in metres, hold
    each joint's position relative to its parent in the rest pose, zero for roots; only a tree or forest has them.

    Raises `ValueError` for repeated names, unknown joints, self-loops, repeated bones and misshapen offsets.
    """

    names: tuple[str, ...]
    edges: tuple[tuple[int, int], ...]
    rest_offsets: tuple[tuple[float, float, float], ...] | None = None

    def __init__(
        self,
        names: Iterable[str],
        edges: Iterable[Sequence[int | str]] = (),
        rest_offsets: np.ndarray | Sequence[Sequence[float]] | None = None,
    ):
        names = tuple(str(name) for name in names)
        if not names:
            raise ValueError("received a skeleton without joints: name at least one")
        if len(set(names)) != len(names):
            twice = next(name for name, count in Counter(names).items() if count > 1)
            raise ValueError(f"received joint name {twice!r} more than once: names must be distinct")
        index = {name: i for i, name in enumerate(names)}
        pairs = []
        for edge in edges:
            if len(edge) != 2:
                raise ValueError(f"received bone {tuple(edge)!r}: a bone is a pair of joints")
            pair = []
            for joint in edge:
                known = joint in index if isinstance(joint, str) else 0 <= joint < len(names)
                if not known:
                    raise ValueError(f"received bone {tuple(edge)!r}: {joint!r} is none of the {len(names)} joints")
                pair.append(index[joint] if isinstance(joint, str) else int(joint))
            if pair[0] == pair[1]:
                raise ValueError(f"received a bone from joint {names[pair[0]]!r} to itself: remove it")
            pairs.append((pair[0], pair[1]))
        if len({len(names) * min(pair) + max(pair) for pair in pairs}) != len(pairs):
            raise ValueError("received the same bone more than once: list each bone once")
        object.__setattr__(self, "names", names)
        object.__setattr__(self, "edges", tuple(pairs))
        object.__setattr__(self, "rest_offsets", None)
        if rest_offsets is not None:
            offsets = np.asarray(rest_offsets, float)
            if offsets.shape != (len(names), 3) or not (np.abs(offsets) <= FARTHEST).all():
                raise ValueError(
                    f"received rest offsets of shape {offsets.shape} for {len(names)} joints: "
                    f"give finite offsets in metres of shape ({len(names)}, 3)"
                )
            self.parents  # noqa: B018  only a forest has offsets from parents: this raises for any other graph
            object.__setattr__(self, "rest_offsets", tuple(map(tuple, offsets.tolist())))

    @classmethod
    def from_parents(
        cls, names: Iterable[str], parents: Iterable[int], rest_offsets: np.ndarray | None = None
    ) -> Skeleton:
        """Skeleton from each joint's parent index; -1 marks a root. Raises `ValueError` for a cycle."""
        names, parents = tuple(names), [int(p) for p in parents]
        if len(names) != len(parents):
            raise ValueError(f"received {len(names)} joint names and {len(parents)} parents: give one parent a joint")
        skeleton = cls(names, [(p, j) for j, p in enumerate(parents) if p != -1], rest_offsets)
        skeleton.parents  # noqa: B018  refuses a cycle
        return skeleton

    @classmethod
    def from_file(cls, path: str | Path) -> Skeleton:
        """Skeleton from a TOML file with `names` and either `parents` or `edges`.

        Parents are indices or names, -1 or "" for a root. Raises `ValueError` when the file is not such a file.
        """
        path = Path(path)
        try:
            table = tomllib.loads(path.read_text(encoding="utf-8"))
        except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError) as error:
            raise ValueError(f"{path} is not a TOML file: {error}") from error
        if "names" not in table or ("parents" in table) == ("edges" in table):
            raise ValueError(
                f"{path} holds {sorted(table)}: a skeleton file has `names` and either `parents` or `edges`"
            )
        names = table["names"]
        if not _all_of(names, str):
            raise ValueError(f"{path} has `names` that are no list of texts: name each joint")
        try:
            if "edges" in table:
                if not isinstance(table["edges"], list) or not all(_all_of(bone, str | int) for bone in table["edges"]):
                    raise ValueError("received `edges` that are no list of bones: give a pair of joints for each")
                return cls(names, table["edges"])
            parents = table["parents"]
            if not _all_of(parents, str | int):
                raise ValueError("received `parents` that are no list of joints: give one for each joint")
            index = {name: joint for joint, name in enumerate(names)} | {"": -1}
            unknown = [p for p in parents if isinstance(p, str) and p not in index]
            if unknown:
                raise ValueError(f"received the parent {unknown[0]!r}, which is none of its joints")
            return cls.from_parents(names, [index[p] if isinstance(p, str) else p for p in parents])
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from error

    @classmethod
    def standard(cls, name: str) -> Skeleton:
        """One of the named standards, `STANDARDS`."""
        if name not in STANDARDS:
            raise ValueError(f"received skeleton {name!r}: the standards are {', '.join(STANDARDS)}")
        return cls(*table(name))

    @property
    def parents(self) -> tuple[int, ...]:
        """Each joint's parent, -1 for a root.

        Raises `ValueError` where the bones, read as (parent, child), give a joint two parents or a cycle.
        """
        parents = [-1] * len(self.names)
        for parent, child in self.edges:
            if parents[child] != -1:
                raise ValueError(
                    f"joint {self.names[child]!r} has the parents {self.names[parents[child]]!r} and "
                    f"{self.names[parent]!r}: the skeleton is a general graph, not a tree of (parent, child) bones"
                )
            parents[child] = parent
        rooted = {-1}
        for joint in range(len(parents)):
            above, at = [], joint
            while at not in rooted:
                above.append(at)
                # Reached twice before a root: no chain without a cycle is as long as there are joints.
                if len(above) > len(parents):
                    raise ValueError(f"the bones above joint {self.names[joint]!r} form a cycle: a tree has none")
                at = parents[at]
            rooted.update(above)
        return tuple(parents)

    @property
    def mirror(self) -> tuple[tuple[int, int], ...]:
        """Pairs (left, right) of joints whose names differ by their side only, in order of the left one.

        A side is `left` anywhere in a name, or an l at either end of a word in it: HandLeft, mixamorig:LeftArm,
        left_hip, lfemur, LHipJoint, hand.L, Bip01 L Thigh.
        """
        index = {name: joint for joint, name in enumerate(self.names)}
        pairs = []
        for joint, name in enumerate(self.names):
            for side in re.finditer(r"left|(?<![a-z])l|l(?![a-z])", name, re.IGNORECASE):
                right = index.get(name[: side.start()] + _right(side[0]) + name[side.end() :])
                if right is not None:
                    pairs.append((joint, right))
                    break
        return tuple(pairs)

    @property
    def other_side(self) -> tuple[int, ...]:
        """Of each joint the one that `mirror` pairs it with; itself where there is none."""
        other = list(range(len(self.names)))
        for left, right in self.mirror:
            other[left], other[right] = right, left
        return tuple(other)

    @property
    def components(self) -> list[list[int]]:
        """Groups of joints that bones connect, each sorted, in order of their first joint."""
        return components(self.edges, len(self.names))

    @property
    def is_forest(self) -> bool:
        """Whether the bones close no cycle, so that leaf-to-root elimination applies."""
        return is_forest(self.edges, len(self.names))

    @property
    def bone_names(self) -> tuple[str, ...]:
        """`parent-child` for each bone."""
        return tuple(f"{self.names[i]}-{self.names[j]}" for i, j in self.edges)

    @property
    def rest_lengths(self) -> np.ndarray | None:
        """Bone lengths (bone,) of the rest pose in metres, or None where no rest pose is known."""
        if self.rest_offsets is None:
            return None
        return np.linalg.norm(np.asarray(self.rest_offsets)[[child for _, child in self.edges]], axis=-1).reshape(-1)

    def bone_lengths_of(self, positions: np.ndarray) -> np.ndarray:
        """Lengths (frame, bone) of the bones in positions (frame, joint, 3), in the unit of the positions."""
        return bone_lengths(positions, self.edges)

    def select(self, names: Sequence[str]) -> Skeleton:
        """The named joints in the given order; each is tied to its nearest kept ancestor.

        Rest offsets are kept where no joint between two kept ones is left out: a bone across a moving joint is not
        rigid. A general graph has no ancestors: of its bones those between kept joints stay. Raises `ValueError` for
        unknown names.
        """
        for name in names:
            if name not in self.names:
                raise ValueError(f"received joint {name!r}: the skeleton has {', '.join(self.names)}")
        try:
            parents = self.parents
        except ValueError:
            bones = ((self.names[i], self.names[j]) for i, j in self.edges)
            return Skeleton(names, [bone for bone in bones if {*bone} <= {*names}])
        kept = [self.names.index(name) for name in names]
        ancestors = []
        for joint in kept:
            at = parents[joint]
            while at != -1 and at not in kept:
                at = parents[at]
            ancestors.append(at)
        rigid = self.rest_offsets is not None and all(a == parents[j] for j, a in zip(kept, ancestors, strict=True))
        offsets = np.asarray(self.rest_offsets)[kept] if rigid else None
        return Skeleton.from_parents(names, [-1 if a == -1 else kept.index(a) for a in ancestors], offsets)


def bone_lengths(positions: np.ndarray, edges: np.ndarray | Sequence[Sequence[int]]) -> np.ndarray:
    """Lengths (frame, bone) in positions (frame, joint, 3) of bones given as pairs of joints; NaN without an end."""
    i, j = np.asarray(edges, int).reshape(-1, 2).T
    return np.linalg.norm(positions[:, i] - positions[:, j], axis=-1)


def components(edges: Sequence[tuple[int, int]], joints: int) -> list[list[int]]:
    """Groups of the `joints` that the edges connect, each sorted, in order of their first joint."""
    group = list(range(joints))
    for i, j in edges:
        a, b = group[i], group[j]
        group = [a if g == b else g for g in group]
    found: dict[int, list[int]] = {}
    for joint, g in enumerate(group):
        found.setdefault(g, []).append(joint)
    return list(found.values())


def is_forest(edges: Sequence[tuple[int, int]], joints: int) -> bool:
    """Whether the edges close no cycle, so that leaf-to-root elimination applies."""
    return len(edges) == joints - len(components(edges, joints))


def _all_of(values: object, kind: type | UnionType) -> bool:
    """Whether `values` is a list of such values only."""
    return isinstance(values, list) and all(isinstance(value, kind) for value in values)


def _right(side: str) -> str:
    """`right` for `left`, r for l, in the same case."""
    right = "right" if len(side) > 1 else "r"
    return right.upper() if side.isupper() else right.title() if side.istitle() else right
