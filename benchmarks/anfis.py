# ruff: noqa: E402
"""Error and speed of the neuro-fuzzy network, compared with other packages if they are installed.

    python benchmarks/anfis.py [--quick]

The peers are anfis-toolbox (PyPI) and scipy (L-BFGS on the same objective). The tables of docs/anfis.md are the output
of this program. It uses one thread, because on a busy machine several threads wait for each other.
"""

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_name] = "1"  # before numpy is imported

import argparse
import itertools
import logging
import statistics
import time
from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
from scipy.optimize import minimize

from nav_pose_estimator import Anfis
from nav_pose_estimator.core.learning.conjugate_gradient import fletcher_reeves
from nav_pose_estimator.core.learning.hybrid_learning import ReducedObjective
from nav_pose_estimator.core.learning.partition import grid_premises
from nav_pose_estimator.core.learning.takagi_sugeno import Premises
from nav_pose_estimator.core.numerics.jit import COMPILED

Samples = tuple[np.ndarray, np.ndarray]


def mackey_glass_series(start: float = 1.2, delayed: str = "held", length: int = 1200) -> np.ndarray:
    """Mackey-Glass series at t = 0, 1, ...: dx/dt = 0.2 x(t - 17) / (1 + x(t - 17)^10) - 0.1 x, with x = 0 for t < 0.

    It is integrated by RK4 with a step of 0.1. ``delayed``: within a step x(t - 17) is ``held``, as in the classic
    generator, or ``interpolated``.
    """
    step, lag = 0.1, 170
    x = np.zeros(lag + 1 + 10 * length)
    x[lag] = start

    def slope(now: float, then: float) -> float:
        return 0.2 * then / (1.0 + then**10) - 0.1 * now

    for k in range(lag, len(x) - 1):
        first = x[k - lag]
        last = first if delayed == "held" else x[k - lag + 1]
        middle = 0.5 * (first + last)
        k1 = slope(x[k], first)
        k2 = slope(x[k] + 0.5 * step * k1, middle)
        k3 = slope(x[k] + 0.5 * step * k2, middle)
        k4 = slope(x[k] + step * k3, last)
        x[k + 1] = x[k] + step / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return x[lag::10]


def mackey_glass(start: float = 1.2, delayed: str = "held") -> tuple[Samples, Samples]:
    """500 training and 500 checking samples from t = 118 on: x(t-18), x(t-12), x(t-6), x(t) -> x(t+6)."""
    x, t = mackey_glass_series(start, delayed), np.arange(118, 1118)
    inputs, target = np.column_stack([x[t - 18], x[t - 12], x[t - 6], x[t]]), x[t + 6][:, None]
    return (inputs[:500], target[:500]), (inputs[500:], target[500:])


def drag_like(samples: int = 3000) -> tuple[np.ndarray, np.ndarray]:
    """Ten inputs, two smooth outputs with noise: (10, N), (2, N), standardised."""
    random = np.random.default_rng(0)
    x = random.normal(size=(10, samples))
    y = np.stack([np.sin(x[0]) * x[1] + 0.3 * x[2] ** 2, np.tanh(x[4] - x[5]) + 0.2 * x[6] * x[7]])
    y = y / y.std(axis=1)[:, None] + 0.1 * random.normal(size=y.shape)
    return x, (y - y.mean(axis=1)[:, None]) / y.std(axis=1)[:, None]


def rms(error: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(error))))


def seconds(call: Callable[[], object], repeat: int) -> float:
    """Smallest elapsed time [s] of ``repeat`` calls."""
    best = np.inf
    for _ in range(repeat):
        begin = time.perf_counter()
        call()
        best = min(best, time.perf_counter() - begin)
    return best


def row(*cells: object) -> None:
    print("| " + " | ".join(str(cell) for cell in cells) + " |")


def header(title: str, *cells: str) -> None:
    print(f"\n{title}\n")
    row(*cells)
    row(*["---"] * len(cells))


def series_table(repeat: int, epochs: tuple[int, ...]) -> None:
    header("Mackey-Glass, 16 rules", "", "training RMSE", "checking RMSE", "time, s")
    for delayed in ("held", "interpolated"):
        training, checking = mackey_glass(delayed=delayed)
        used = seconds(partial(_fit, *training), repeat)
        row(f"Anfis(rules=16), {delayed}", *(f"{e:.5f}" for e in errors(training, checking)), f"{used:.2f}")
        for count in epochs:
            peer_row(training, checking, count, delayed, used)
        others = (0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1, 1.3, 1.4, 1.5)
        pairs = [errors(*mackey_glass(start, delayed)) for start in others]
        middle = [statistics.median(column) for column in zip(*pairs, strict=True)]
        row(f"Anfis(rules=16), {delayed}, median of ten other x(0)", *(f"{e:.5f}" for e in middle), "")


def errors(training: Samples, checking: Samples) -> tuple[float, ...]:
    model = Anfis(rules=16).fit(*training)
    return tuple(rms(model.predict(x) - y) for x, y in (training, checking))


def peer_row(training: Samples, checking: Samples, epochs: int, delayed: str, ours: float) -> None:
    try:
        from anfis_toolbox import ANFISRegressor
    except ImportError:
        return
    logging.disable()
    # settings: the best of its three trainers, four learning rates and two kinds of memberships on this task
    settings = {"n_mfs": 2, "mf_type": "bell", "optimizer": "hybrid_adam", "learning_rate": 0.1}
    peer = ANFISRegressor(**settings, epochs=epochs, random_state=0)
    used = seconds(lambda: peer.fit(training[0], training[1][:, 0]), 1)
    reached = (rms(peer.predict(x) - y[:, 0]) for x, y in (training, checking))
    name = f"anfis-toolbox, {epochs} epochs, {delayed}"
    row(name, *(f"{e:.5f}" for e in reached), f"{used:.2f} ({used / ours:.0f} times ours)")


def problems() -> Iterator[tuple[str, ReducedObjective]]:
    (x, y), _ = mackey_glass()
    z, t = (x - x.mean(axis=0)) / x.std(axis=0), (y - y.mean(axis=0)) / y.std(axis=0)
    yield "Mackey-Glass, 192 premises", ReducedObjective(grid_premises(z, 2, 0.8, 4.0), z.T, t.T, 1e-9, 1e-6)
    inputs, targets = drag_like()
    centre = inputs[:, np.random.default_rng(1).choice(inputs.shape[1], 16, replace=False)]
    premises = Premises(centre, np.full_like(centre, 1.177 * np.sqrt(10.0)), np.ones_like(centre))
    yield "ten inputs, 16 rules, 480 premises", ReducedObjective(premises, inputs, targets, 1e-3, 1e-3)


def optimiser_table(iterations: int) -> None:
    title = f"{iterations} iterations on the same reduced objective"
    header(title, "problem", "method", "objective", "evaluations", "time, s", "time to reach L-BFGS's last value, s")
    for name, objective in problems():
        lbfgs = trace_lbfgs(objective, iterations)
        guided = (objective.metric, objective.curvature)
        for method, trace in (
            ("gradient descent", trace_search(objective, iterations, None, None, period=1)),
            ("Fletcher-Reeves", trace_search(objective, iterations, None, None)),
            ("Fletcher-Reeves, Gauss-Newton first step", trace_search(objective, iterations, None, guided[1])),
            ("Fletcher-Reeves, Gauss-Newton metric (used)", trace_search(objective, iterations, *guided)),
            ("scipy L-BFGS", lbfgs),
        ):
            reached = next(
                (f"{t:.2f} (iteration {k})" for k, (v, t, _) in enumerate(trace, 1) if v <= lbfgs[-1][0]), "-"
            )
            value, used, evaluations = trace[-1]
            row(name, method, f"{value:.3e}", evaluations, f"{used:.2f}", reached)


Trace = list[tuple[float, float, int]]


def trace_search(objective: ReducedObjective, iterations: int, metric, curvature, **options) -> Trace:
    """(value, time, evaluations) after every iteration."""
    objective.evaluations, begin, trace = 0, time.perf_counter(), []
    search = fletcher_reeves(objective, objective.start, metric, curvature, **options)
    for iterate in itertools.islice(search, iterations):
        trace.append((iterate.value, time.perf_counter() - begin, objective.evaluations))
    return trace


def trace_lbfgs(objective: ReducedObjective, iterations: int) -> Trace:
    objective.evaluations, begin, trace = 0, time.perf_counter(), []

    def note(intermediate_result) -> None:
        trace.append((intermediate_result.fun, time.perf_counter() - begin, objective.evaluations))

    options = {"maxiter": iterations, "maxfun": 10**6, "ftol": 1e-16, "gtol": 1e-12}
    minimize(objective, objective.start, jac=True, method="L-BFGS-B", callback=note, options=options)
    return trace


def _fit(inputs: np.ndarray, targets: np.ndarray) -> None:
    Anfis(rules=16).fit(inputs, targets)


def _predict(model: Anfis, x: np.ndarray, times: int) -> None:
    for _ in range(times):
        model.predict_one(x)


def speed_table(repeat: int) -> None:
    header("Speed, 3000 samples, 10 inputs, 2 outputs, one thread", "rules", "50 iterations, s", "one prediction, us")
    inputs, targets = drag_like()
    for rules in (4, 8, 16, 32):
        model = Anfis(rules, iterations=50, patience=50)
        used = seconds(partial(model.fit, inputs.T, targets.T), repeat)
        x = inputs[:, 0].copy()
        model.predict_one(x)
        one = seconds(partial(_predict, model, x, 2000), 7) / 2000
        row(rules, f"{used:.2f}", f"{1e6 * one:.1f}")
    print(f"\nKernels are {'compiled' if COMPILED else 'plain Python'}.")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="few repetitions, few epochs of the peer")
    quick = parser.parse_args().quick
    series_table(repeat=2 if quick else 5, epochs=(20,) if quick else (100, 500))
    optimiser_table(iterations=15 if quick else 50)
    speed_table(repeat=1 if quick else 3)


if __name__ == "__main__":
    main()
