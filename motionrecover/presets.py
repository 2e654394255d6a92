"""Presets: `robust`, the default, and the published models as settings of the one ADM solver."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from motionrecover.solver import Problem, Solver


@dataclass(frozen=True)
class Preset:
    """Settings of the solver for data in metres; `dataclasses.replace(PRESETS[name], field=value)` gives others.

    `initialisation="printed"` runs the letter of Algorithm 1 in Yang et al. 2020: A = 0, coordinates as they come,
    rho = 0.5 growing by 1.3 without end. On every CMU clip tried that fails: the penalty outgrows the problem before
    the split variables agree, and the answer is up to metres off (`docs/reproduction.md`). `initialisation="data"`
    changes three things, none of them in the model: A starts at D; the first penalty is `penalty` / |D|_2 (Lin, Chen
    & Ma, arXiv:1009.5055, Sec. 4.2), so that it follows the scale and length of the clip; and growth ends at `reach`
    and `isometry_penalty_max`, where the iteration can converge and the residuals mean something. It also puts the
    origin at the median of the observed samples, because the nuclear norm and the wavelet term of Eq. 7 depend on it,
    and takes long clips in windows.
    """

    name: str
    outlier_weight: float = 1.0
    """lambda = outlier_weight / sqrt(T) (Yang et al. 2020, Sec. IV-A1). Higher explains less as outliers."""
    isometry_weight: float | None = None
    """gamma in 1 / m^3; None leaves the term out. Higher keeps bones more rigid."""
    smoothness_weight: float | None = None
    """mu; None leaves the term out. Higher gives smoother, slower motion."""
    guide_weight: float = 10.0
    """beta in 1 / m, where `recover` is given a guide; 0 leaves the term out. Higher stays nearer the guide."""
    wavelet: str = "db10"
    """Any orthogonal wavelet of PyWavelets."""
    level: int = 2
    """J. Higher smooths over longer times."""
    penalty: float = 1.25
    """rho_1..3 of the first step times |D|_2. Higher stays nearer the start."""
    penalty_growth: float = 1.3
    """eta_1..3 (Sec. IV-A4). Higher commits sooner."""
    reach: float = 0.02
    """Metres. Growth of rho_1 and rho_3 ends at lambda / reach: the residual that one step can still absorb."""
    # The isometry term is not convex: its penalty must exceed the negative curvature gamma |F| of a shortened bone, or
    # Gauss-Newton steps overshoot for ever; the other two converge fastest below it. Wherever the iteration converges
    # the answer is the same, other settings only take more steps: benchmarks/studies/penalties.py.
    isometry_penalty_max: float = 10.0
    """Where the growth of rho_2 ends, in 1 / m, or at lambda / reach if that is more."""
    tolerance: float = 1e-3
    """Both residuals must fall below it."""
    max_steps: int = 1000
    window: int | None = 100
    """Frames. Longer clips are recovered in overlapping windows of at most so many; None recovers them whole. "It is
    better to take 50 to 300 frames" (Sec. IV-A4): lambda falls with the length of the clip and mu does not, so over
    a long one smoothness outweighs the data."""
    overlap: int = 16
    """Frames that neighbouring windows share; one answer fades into the other over them."""
    fill_reach: float = 10.0
    """Frames. A straight line across a gap is trusted 1 / (1 + d / fill_reach) at d frames from the nearest sample.
    With no trust, the nuclear norm and the wavelet term draw frames without any sample to the origin."""
    # With 1 or 2 frames some clips come back worse than they went in, from 3 on none: benchmarks/studies/penalties.py.
    min_frames: int = 3
    """Shorter clips are refused: the model learns from time."""
    initialisation: Literal["data", "printed"] = "data"

    def solver(self, problem: Problem) -> Solver:
        """The solver for a problem of one clip; scalars become arrays, so other values compile nothing anew."""
        # Here, so that names and settings are at hand without JAX.
        import numpy as np

        from motionrecover.solver import Solver

        dtype = problem.positions.dtype
        weight = self.outlier_weight / np.sqrt(int(problem.frames))
        if self.initialisation == "printed":
            # 1e6 instead of no end: beyond, only rounding errors change and float32 overflows after 340 steps.
            penalty, penalty_max = np.full(3, 0.5), np.full(3, 1e6)
        elif self.initialisation == "data":
            d = np.asarray(problem.positions, np.float64)
            size = np.sqrt(np.linalg.eigvalsh(np.einsum("cit,cjt->ij", d, d))[-1])
            end = weight / self.reach
            penalty = np.full(3, self.penalty / size if size > 0 else 1.0)
            penalty_max = np.array([end, max(end, self.isometry_penalty_max), end])
        else:
            raise ValueError(f"received initialisation {self.initialisation!r}: give 'data' or 'printed'")

        def array(value) -> Any:  # of NumPy: JAX would convert each by a program of its own
            return np.asarray(value, dtype)

        return Solver(
            outlier_weight=array(weight),
            isometry_weight=array(self.isometry_weight or 0.0),
            smoothness_weight=array(self.smoothness_weight or 0.0),
            guide_weight=array(self.guide_weight),
            penalty=array(penalty),
            penalty_growth=array(np.full(3, self.penalty_growth)),
            penalty_max=array(penalty_max),
            tolerance=array(self.tolerance),
            isometry=self.isometry_weight is not None,
            smoothness=self.smoothness_weight is not None,
            guided=problem.guide is not None and self.guide_weight > 0,
            zero_start=self.initialisation == "printed",
            wavelet=self.wavelet,
            level=self.level,
        )


@dataclass(frozen=True)
class Robust:
    """Settings of the robust recovery (`motionrecover.robust`); what a clip needs it finds in the clip."""

    name: str = "robust"
    max_steps: int = 60
    """Of the smoother in one window. The first 15 only bring the noise level down."""
    window: int | None = 400
    """Frames. Longer clips are recovered in overlapping windows: how joints move together changes with what a person
    does. None recovers them whole."""
    overlap: int = 48
    """Frames that neighbouring windows share; one answer fades into the other over them."""


PUBLISHED = {
    preset.name: preset
    for preset in (
        # Wang, Li, Wu, Lai & Yang, "3-D motion recovery via low rank matrix analysis", VCIP 2016.
        Preset("lowrank_wang2016"),
        # Li, Wang, Lai, Yang & Wu, "3-D motion recovery via low rank matrix restoration on articulation graphs",
        # ICME 2017.
        Preset("isometry_li2017", isometry_weight=100.0),
        # Yang, Guo, Li, Wang, Lai & Wu, "Spatio-temporal reconstruction for 3D motion recovery", IEEE TCSVT 30(6),
        # 2020.
        Preset("str_yang2020", isometry_weight=100.0, smoothness_weight=0.01),
    )
}
"""The published models by name."""

PRESETS: dict[str, Preset | Robust] = {"robust": Robust()} | PUBLISHED
"""The presets by name."""


def find(preset: str | Preset | Robust) -> Preset | Robust:
    """The preset itself, or the one of that name. Raises `ValueError` for an unknown name."""
    if isinstance(preset, Preset | Robust):
        return preset
    if preset not in PRESETS:
        raise ValueError(f"received preset {preset!r}: the presets are {', '.join(PRESETS)}")
    return PRESETS[preset]
