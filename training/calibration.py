"""How sure the refinement may be, fitted to what it finds in frames that are kept apart."""

import dataclasses
import itertools

import numpy as np
from places import KINDS, LABELS, PHOTOGRAPH
from scipy.optimize import minimize

from coded_aperture_ros.depth.decoders.network.network import Calibration

_PUBLISHED = 0.45
_LEAST = 1e-3
# Small network of the confidence: outputs of its layers, weight of the squares of its weights, and
# steps of its fit.
_HIDDEN = (16, 16)
_DECAY = 1e-4
_STEPS = 250
_FOLDS = 3

Layers = list[np.ndarray]


def confidence_calibration(places: np.ndarray) -> Calibration:
    """Calibration of the confidence by places; print how it does on what was left out.

    First kinds are left out, then thirds of the photographs and rooms.
    """
    kind, group = places[-2].astype(int), places[-1].astype(int)
    for number, name in enumerate(KINDS):
        left_out = kind == number
        if left_out.all() or not left_out.any():
            continue
        _print_scores(f"{name}, by the others", _fit(places[:, ~left_out]), places[:, left_out])
    for fold in range(_FOLDS):
        left_out = group % _FOLDS == fold
        if left_out.all() or not left_out.any():
            continue
        found = _fit(places[:, ~left_out])
        for number, name in enumerate(KINDS):
            part = places[:, left_out & (kind == number)]
            if part.size:
                _print_scores(f"{name}, fold {fold}", found, part)
    return _fit(places)


def _print_scores(name: str, calibration: Calibration, places: np.ndarray) -> None:
    features, right, nearly = places[:-LABELS], places[-LABELS], places[1 - LABELS]
    said = calibration.confidence(features).astype(np.float64).clip(1e-4, 1 - 1e-4)
    published = said >= _PUBLISHED
    likelihood = right * np.log(said) + (1 - right) * np.log(1 - said)
    print(
        f"{name}: cross-entropy {-likelihood.mean():.3f}, said {said.mean():.2f}, right "
        f"{right.mean():.2f}, published {published.mean():.2f}, of these right to 10 % "
        f"{nearly[published].mean() if published.any() else np.nan:.2f}"
    )


def _fit(places: np.ndarray) -> Calibration:
    """Small network that makes what is right the likeliest; every kind of frames counts as much.

    The three kinds of the generator are one.
    """
    features, right = places[:-LABELS], places[-LABELS]
    kind = np.maximum(places[-2].astype(int), PHOTOGRAPH - 1)
    weight = (1 / np.maximum(np.bincount(kind), 1))[kind]
    mean = features.mean(axis=1, keepdims=True)
    scale = np.maximum(features.std(axis=1, keepdims=True), _LEAST)
    scaled = ((features - mean) / scale).astype(np.float32)
    random = np.random.default_rng(0)
    start = [
        np.append(random.normal(0, np.sqrt(2 / given), (out, given)), np.zeros((out, 1)), axis=1)
        for given, out in itertools.pairwise((len(features), *_HIDDEN, 1))
    ]
    ends = np.cumsum([layer.size for layer in start])[:-1]

    def loss(values: np.ndarray) -> tuple[float, np.ndarray]:
        parts = zip(np.split(values, ends), start, strict=True)
        layers = [part.reshape(layer.shape).astype(np.float32) for part, layer in parts]
        unlikelihood, slopes = _unlikelihood(layers, scaled, right, weight / weight.sum())
        slope = np.concatenate([each.ravel() for each in slopes])
        return unlikelihood + _DECAY / 2 * float(values @ values), slope + _DECAY * values

    first = np.concatenate([layer.ravel() for layer in start])
    options = {"maxiter": _STEPS, "maxcor": 20}
    found = minimize(loss, first, jac=True, method="L-BFGS-B", options=options).x
    layers = [
        part.reshape(layer.shape) for part, layer in zip(np.split(found, ends), start, strict=True)
    ]
    # The first layer takes features as they are.
    layers[0][:, :-1] /= scale.T
    layers[0][:, -1:] -= layers[0][:, :-1] @ mean
    return Calibration(tuple(layer.astype(np.float32) for layer in layers), np.float32(1))


def _unlikelihood(
    layers: Layers, features: np.ndarray, right: np.ndarray, weight: np.ndarray
) -> tuple[float, Layers]:
    """Mean cross-entropy of a network, and its slopes by the layers' weights and biases."""
    given = [features]
    for layer in layers[:-1]:
        given.append(np.maximum(layer[:, :-1] @ given[-1] + layer[:, -1:], 0))
    odds = (layers[-1][:, :-1] @ given[-1] + layers[-1][:, -1:])[0]
    back = (weight * (1 / (1 + np.exp(-odds)) - right)).astype(np.float32)[None]
    slopes: Layers = []
    for layer, values in zip(reversed(layers), reversed(given), strict=True):
        slopes.append(np.append(back @ values.T, back.sum(axis=1, keepdims=True), axis=1))
        back = (layer[:, :-1].T @ back) * (values > 0)
    return float(weight @ (np.logaddexp(0, odds) - right * odds)), slopes[::-1]


def calibration_arrays(calibration: Calibration) -> dict[str, np.ndarray]:
    """Arrays of a calibration in the weights' file, by their names."""
    layers = {f"confidence{number}": layer for number, layer in enumerate(calibration.layers)}
    return {**layers, "deviation": np.array(calibration.deviation)}


def deviation_calibration(
    places: np.ndarray, calibration: Calibration, former: np.float32
) -> Calibration:
    """Calibration with the factor of the standard deviation, by the errors of what is published.

    68 % of them are within it in every kind of frames, of some kinds more. Prints how well the
    confidence holds. `former` is the factor that the places were found with.
    """
    features, right, errors, kind = (
        places[:-LABELS],
        places[-LABELS],
        places[2 - LABELS],
        places[-2],
    )
    confidence = calibration.confidence(features)
    published = confidence >= _PUBLISHED
    if not published.any():
        raise SystemExit("the network is sure of nothing: fit it for longer")
    for low in np.arange(0, 1, 0.1):
        part = (confidence >= low) & (confidence < low + 0.1)
        if part.any():
            means = (confidence[part].mean(), right[part].mean(), part.mean())
            print(f"{low:.1f}: " + " ".join(f"{mean:.3f}" for mean in means))
    factors = {
        name: former * np.nanquantile(errors[published & (kind == number)], 0.68)
        for number, name in enumerate(KINDS)
        if (published & (kind == number)).any()
    }
    factor = max(factors.values())
    print(f"deviation: {factor:.3f}; {factors}")
    return dataclasses.replace(calibration, deviation=np.float32(factor))
