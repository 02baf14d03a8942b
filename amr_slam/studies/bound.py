"""How near to the best possible one scan comes: error against the Cramér-Rao bound.

The bound is that of one scan against walls that are known exactly. The product knows them only
from noisy mapping scans, so it can reach the bound with a perfect map alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import chi2

from amr_slam.evaluation import error95_coverage, nees
from amr_slam.fusion import error95_m
from amr_slam.geometry import Array, Pose2, inverse_matrix, wrap_angle
from amr_slam.params import SlamParams
from amr_slam.pictures import style
from amr_slam.simulation import ScannerModel, World, cast
from amr_slam.slam import Verdict, slam_absolute
from amr_slam.studies.report import Effort, Picture, Section, Table
from amr_slam.studies.scenes import Scene, is_right, laboratory_scene, with_noise

SIGMAS_M: Final = (0.03, 0.1, 0.2, 0.3)
"""Noise in both x and y of each point, in the mapping scans and in the localized ones."""
POSES: Final = 40
"""Localized scans in each world at each noise level."""
MOST: Final = {0.1: 1.3, 0.2: 1.4, 0.3: 1.8}
"""RMSE over bound that is required at most."""
WANTED: Final = {0.1: 1.0, 0.2: 1.1, 0.3: 1.25}
"""RMSE over bound that is aimed at."""

_FIRST_SEED = 7000
_RESAMPLES = 500


def cramer_rao(world: World, pose: Pose2, model: ScannerModel, sigma_m: float) -> Array:
    """(3, 3) least covariance of (x, y, theta) that an unbiased estimate from one scan can have.

    ``pose`` is world_from_base; ``sigma_m`` the noise in x and in y of each measured point, so
    that each point's distance to its wall has this standard deviation, however oblique the beam.
    With the wall's normal n and the arm a from the base to the point, a point tells
    j = (n_x, n_y, a x n) and the information is the sum of j j' / sigma^2 (Censi, "On achievable
    accuracy for range-finder localization", ICRA 2007, for this noise).

    Walls are taken for straight and endless where a beam meets them: that noise may carry a
    point round a corner or across the edge of a nearer thing is left out.
    Raises numpy.linalg.LinAlgError where the walls leave a direction open.
    """
    points, normals = _hits(world, pose @ model.base_from_lidar, model)
    arm = points - pose.translation
    lever = arm[:, 0] * normals[:, 1] - arm[:, 1] * normals[:, 0]
    jacobian = np.column_stack([normals, lever])
    return inverse_matrix(jacobian.T @ jacobian / sigma_m**2)


def _hits(world: World, world_from_lidar: Pose2, model: ScannerModel) -> tuple[Array, Array]:
    """Points (n, 2) where the beams end, and the unit normals (n, 2) of the walls there, in the
    world."""
    angles = world_from_lidar.theta_rad + model.angles_rad
    origins = np.broadcast_to(world_from_lidar.translation, (len(angles), 2))
    ranges = cast(origins, angles, world.segments_m)
    met = ranges < model.range_max_m
    directions = np.column_stack([np.cos(angles), np.sin(angles)])
    points = origins[met] + ranges[met, None] * directions[met]
    start, edge = world.segments_m[:, :2], world.segments_m[:, 2:] - world.segments_m[:, :2]
    along = edge / np.linalg.norm(edge, axis=1, keepdims=True)
    normal = np.column_stack([-along[:, 1], along[:, 0]])
    # The wall that was met is the one on which the point lies.
    offset = points[:, None] - start
    beside = np.abs(np.einsum("nsd,sd->ns", offset, normal))
    beyond = np.einsum("nsd,sd->ns", offset, edge) / np.sum(edge**2, axis=1)
    beyond = np.abs(beyond - np.clip(beyond, 0.0, 1.0))
    return points, normal[np.argmin(beside + beyond, axis=1)]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Localized:
    """Answers of one world at one noise level that were right (0.25 m, 5 degrees): k of them."""

    errors: Array
    """(k, 3) x, y, theta: answer less truth."""
    covariances: Array
    """(k, 3, 3) as the registration reports them."""
    bounds: Array
    """(k, 3, 3) Cramér-Rao bounds."""
    accepted: int
    """Right ones that the strategy accepted from this one scan."""
    tried: int

    @staticmethod
    def of(scene: Scene, sigma_m: float, poses: Sequence[Pose2], params: SlamParams) -> Localized:
        """Maps the scene at its true poses, then finds one new scan at each of ``poses``."""
        model = with_noise(sigma_m)
        known = scene.map_at_truth(model, params)
        rng = np.random.default_rng((scene.world.seed, 1))
        errors: list[Array] = []
        covariances: list[Array] = []
        bounds: list[Array] = []
        accepted = 0
        for pose in poses:
            answer = slam_absolute(scene.cloud(model, pose, rng, params.clouds), known, params)
            if answer.best is None or not is_right(answer.best.pose, pose):
                continue
            error = answer.best.pose.as_array() - pose.as_array()
            error[2] = wrap_angle(float(error[2]))
            errors.append(error)
            covariances.append(inverse_matrix(answer.best.alignment.information))
            bounds.append(cramer_rao(scene.world, pose, model, sigma_m))
            accepted += answer.verdict is Verdict.ACCEPTED
        return Localized(
            errors=np.array(errors).reshape(-1, 3),
            covariances=np.array(covariances).reshape(-1, 3, 3),
            bounds=np.array(bounds).reshape(-1, 3, 3),
            accepted=accepted,
            tried=len(poses),
        )

    @staticmethod
    def joined(parts: Sequence[Localized]) -> Localized:
        """All of several worlds."""
        return Localized(
            errors=np.concatenate([part.errors for part in parts]),
            covariances=np.concatenate([part.covariances for part in parts]),
            bounds=np.concatenate([part.bounds for part in parts]),
            accepted=sum(part.accepted for part in parts),
            tried=sum(part.tried for part in parts),
        )

    @property
    def position_m(self) -> Array:
        """(k,) position errors."""
        return np.hypot(self.errors[:, 0], self.errors[:, 1])

    @property
    def bound_m(self) -> Array:
        """(k,) root mean square position errors of a perfect estimate."""
        return np.sqrt(self.bounds[:, 0, 0] + self.bounds[:, 1, 1])

    @property
    def nees(self) -> Array:
        """(k,) squared errors normalized by the reported covariance: 3 on average if honest."""
        return nees(self.errors, self.covariances)

    @property
    def coverage(self) -> float:
        """Share of the position errors within the 95 % radius of the reported covariance."""
        radii = np.array([error95_m(covariance) for covariance in self.covariances])
        return error95_coverage(self.position_m, radii)

    @property
    def ratio(self) -> float:
        """RMSE of the position over the root mean square bound."""
        return _rms(self.position_m) / _rms(self.bound_m)

    def axis_ratios(self) -> tuple[float, float, float]:
        """The same of x, y and theta, each alone."""
        variances = np.mean(np.diagonal(self.bounds, axis1=1, axis2=2), axis=0)
        x, y, theta = np.sqrt(np.mean(self.errors**2, axis=0) / variances)
        return float(x), float(y), float(theta)


def run(effort: Effort) -> Section:
    """Map laboratories at true poses, localize scans in them, and compare with the bound."""
    worlds = effort.trials(12, least=2)
    params = SlamParams()
    found: dict[float, list[Localized]] = {sigma: [] for sigma in SIGMAS_M}
    for k in range(worlds):
        scene = laboratory_scene(_FIRST_SEED + 100 * effort.seed + k)
        poses = scene.poses(POSES, np.random.default_rng((scene.world.seed, 2)))
        for sigma in SIGMAS_M:
            found[sigma].append(Localized.of(scene, sigma, poses, params))
        effort.progress(f"bound: world {k + 1} of {worlds}")
    whole = {sigma: Localized.joined(parts) for sigma, parts in found.items()}
    return Section(
        title="Error against the Cramér-Rao bound of one scan",
        text=_TEXT.format(worlds=worlds, poses=POSES),
        tables=(
            Table(
                title="Position and heading against the bound",
                columns=(
                    "noise m", "right of tried", "accepted of these", "RMSE mm", "bound mm",
                    "RMSE / bound (95 %)", "required", "wanted", "x", "y", "heading",
                ),
                rows=tuple(_accuracy(s, whole[s], found[s]) for s in SIGMAS_M),
            ),
            Table(
                title="The reported covariance",
                columns=("noise m", "mean NEES (95 %)", "NEES < 7.81", "error95_m holds"),
                rows=tuple(_consistency(s, whole[s], found[s]) for s in SIGMAS_M),
            ),
        ),
        pictures=(
            Picture(
                name="bound",
                caption="Left: position errors (dots), their RMSE with its 95 % interval, and the "
                "bound. Right: share of answers below a NEES; an honest covariance follows the "
                "dashed line.",
                figure=_figure(whole, found),
            ),
        ),
    )  # fmt: skip


_TEXT: Final = """\
{worlds} laboratories, each mapped by about 85 scans at their true poses and at the stated noise;
in each, {poses} new scans from covered poses are found by the absolute strategy (no prior) with
the default parameters. The bound is that of one scan of 541 beams against exactly known walls: no
map is as good as that, so a ratio of 1 also asks for a map without error.

Errors count where the answer was right (0.25 m, 5°), accepted or not; the table says how many, and
where they are fewer, the ratio flatters. The noise is added to both coordinates of each point; the
registration does not know the beams' angles, by which it could take off the part across them. NEES
and `error95_m` are those of the registration's covariance, before the fusion inflates it. Intervals
come from resampling whole worlds, because scans in one map share its errors. Columns x, y, heading:
RMSE over bound of that axis alone. An honest covariance has a mean NEES of 3, below 7.81 in 95 % of
the cases."""


def _accuracy(sigma_m: float, whole: Localized, parts: Sequence[Localized]) -> tuple[str, ...]:
    low, high = _interval(parts, lambda some: some.ratio)
    return (
        f"{sigma_m:g}",
        f"{len(whole.errors)} of {whole.tried}",
        f"{whole.accepted}",
        f"{1e3 * _rms(whole.position_m):.1f}",
        f"{1e3 * _rms(whole.bound_m):.1f}",
        f"{whole.ratio:.2f} ({low:.2f} to {high:.2f})",
        f"{MOST[sigma_m]:g}" if sigma_m in MOST else "-",
        f"{WANTED[sigma_m]:g}" if sigma_m in WANTED else "-",
        *(f"{ratio:.2f}" for ratio in whole.axis_ratios()),
    )


def _consistency(sigma_m: float, whole: Localized, parts: Sequence[Localized]) -> tuple[str, ...]:
    low, high = _interval(parts, lambda some: float(np.mean(some.nees)))
    return (
        f"{sigma_m:g}",
        f"{np.mean(whole.nees):.2f} ({low:.2f} to {high:.2f})",
        f"{np.mean(whole.nees < chi2.ppf(0.95, 3)):.1%}",
        f"{whole.coverage:.1%}",
    )


def _interval(
    parts: Sequence[Localized], statistic: Callable[[Localized], float]
) -> tuple[float, float]:
    """95 % interval of a statistic by the bootstrap over worlds."""
    rng = np.random.default_rng(0)
    drawn = rng.integers(len(parts), size=(_RESAMPLES, len(parts)))
    values = [statistic(Localized.joined([parts[k] for k in row])) for row in drawn]
    low, high = np.quantile(values, (0.025, 0.975))
    return float(low), float(high)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _figure(whole: dict[float, Localized], parts: dict[float, list[Localized]]) -> Figure:
    figure = style.sheet(10.0, 4.2)
    curves, steps = figure.subplots(1, 2)
    noises = np.array(list(whole))
    limits_mm = 1e3 * np.array([_rms(some.bound_m) for some in whole.values()])
    for name, factors, line in (("required", MOST, "k:"), ("wanted", WANTED, "k--")):
        rows = [k for k, noise in enumerate(noises) if noise in factors]
        bars = [limits_mm[k] * factors[noises[k]] for k in rows]
        curves.plot(noises[rows], bars, line, lw=1, label=name)
    curves.plot(noises, limits_mm, "k-", lw=1, label="Cramér-Rao bound")
    rng = np.random.default_rng(0)
    for k, (noise, some) in enumerate(whole.items()):
        beside = noise * np.exp(rng.uniform(-0.06, 0.06, len(some.errors)))
        curves.plot(beside, 1e3 * some.position_m, ".", ms=2, color=style.look(k).colour, alpha=0.5)
        low, high = _interval(parts[noise], lambda one: _rms(one.position_m))
        middle = _rms(some.position_m)
        spread = 1e3 * np.array([[max(middle - low, 0.0)], [max(high - middle, 0.0)]])
        curves.errorbar(
            noise, 1e3 * middle, spread, fmt="D", ms=5, capsize=4, color=style.look(k).colour
        )
        ranked = np.sort(some.nees)
        share = np.arange(1, len(ranked) + 1) / len(ranked)
        steps.step(ranked, share, color=style.look(k).colour, label=f"noise {noise:g} m")
    curves.set(xscale="log", yscale="log")
    curves.set_xticks(noises, [f"{noise:g}" for noise in noises])
    curves.minorticks_off()
    curves.set_yticks([1, 3, 10, 30, 100, 300], ["1", "3", "10", "30", "100", "300"])
    axis = np.linspace(0.0, 15.0, 200)
    steps.plot(axis, chi2.cdf(axis, 3), "k--", lw=1, label="chi-square, 3 degrees of freedom")
    steps.set(xlim=(0.0, 15.0), ylim=(0.0, 1.0))
    style.chart(curves, x="noise in x and y, m", y="position error, mm", legend="best")
    style.chart(steps, x="NEES", y="share of answers", legend="lower right")
    return figure
