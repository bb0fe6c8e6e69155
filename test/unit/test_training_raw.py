"""Fresh scenes in batches, and networks that are fitted to them."""

import importlib
import json
import sys

import cv2
import numpy as np
import pytest
from scipy.signal import fftconvolve

from coded_aperture_ros.optics import Mask, render_psf_stack

torch = pytest.importorskip("torch", reason="fitting needs torch")

SIDE = 64


@pytest.fixture(scope="module")
def raw(checkout):
    """The program's modules, as they import each other."""
    folder = str(checkout / "training")
    sys.path.insert(0, folder)
    modules = {name: f"raw.{name}" for name in ("planes", "evidence", "samples")}
    modules["fit"] = "fit_raw"
    yield {name: importlib.import_module(module) for name, module in modules.items()}
    sys.path.remove(folder)


@pytest.fixture(scope="module")
def texture():
    random = np.random.default_rng(1)
    rough = random.random((32, 32, 3)).astype(np.float32)
    return np.clip(cv2.resize(rough, (192, 192), interpolation=cv2.INTER_CUBIC), 0, 1)


def _wall(raw, texture, blur_px):
    margin = raw["planes"].MARGIN_PX
    size = SIDE + 2 * margin
    painted = torch.ones(1, 1, 4, size, size)
    painted[0, 0, :3] = torch.from_numpy(texture[:size, :size].transpose(2, 0, 1).copy())
    return raw["planes"].Planes(painted, torch.tensor([[[blur_px, 0.0, 0.0]]]))


@pytest.mark.parametrize("blur_px", [7.3, -12.0])
def test_light_of_a_wall_is_that_of_its_psf(raw, texture, blur_px):
    mask = Mask.named("zhou")  # not the same after half a turn
    planes = _wall(raw, texture, blur_px)
    samples = raw["planes"].aperture_samples(mask, abs(blur_px))
    light = raw["planes"].traced(planes, samples)[0, 1].numpy()
    psf = np.asarray(render_psf_stack(mask, np.array([blur_px])).psfs)[0]
    margin = raw["planes"].MARGIN_PX
    expected = fftconvolve(planes.painted[0, 0, 1].numpy(), psf, mode="same")
    expected = expected[margin:-margin, margin:-margin]
    assert np.abs(light - expected).max() < 0.05 * expected.std()


def test_what_is_near_hides_what_is_behind_it(raw, texture):
    far = _wall(raw, texture, 8.0)
    near = far.painted.clone()
    near[:, :, :3] = 0
    near[..., SIDE // 2 + raw["planes"].MARGIN_PX :] = 0
    blur = torch.tensor([[[0.0, 0.0, 0.0], [8.0, 0.0, 0.0]]])
    both = raw["planes"].Planes(torch.cat([near, far.painted], 1), blur)
    samples = raw["planes"].aperture_samples(Mask.named("levin"), 8)
    light = raw["planes"].traced(both, samples)
    alone = raw["planes"].traced(far, samples)
    # A black plane in focus: its half is black, and beside it nothing is lost.
    assert float(light[..., : SIDE // 2].abs().max()) == 0
    assert torch.allclose(light[..., SIDE // 2 + 1 :], alone[..., SIDE // 2 + 1 :], atol=1e-5)
    sizes = raw["planes"].seen_from_centre(both)[0, 0]
    assert float(sizes[SIDE // 2 - 2]) == 0
    assert float(sizes[SIDE // 2 + 2]) == 8


def test_the_filter_of_the_right_level_sharpens_best(raw):
    texture = np.random.default_rng(2).random((192, 192, 3), np.float32)
    sizes = np.array([3.0, 6.0, 12.0], np.float32)
    wall = _wall(raw, texture, 6.0)
    mask = Mask.named("levin")
    light = raw["planes"].traced(wall, raw["planes"].aperture_samples(mask, 6))
    psfs = torch.from_numpy(np.asarray(render_psf_stack(mask, sizes).psfs, np.float32))
    transfer = raw["evidence"].transfer_functions(psfs, (SIDE, SIDE))
    given = raw["evidence"].evidence(light, torch.tensor([5e-4]), transfer)
    sharp = wall.painted[0, 0, :3].mean(0)
    margin = raw["planes"].MARGIN_PX
    inner = slice(margin + 16, -margin - 16)
    alike = [
        np.corrcoef(sharp[inner, inner].ravel(), one[16:-16, 16:-16].ravel())[0, 1]
        for one in given.sharpened[0].numpy()
    ]
    assert np.argmax(alike) == 1


@pytest.mark.slow
def test_fitting_goes_on_where_it_was_stopped(raw, texture, monkeypatch, tmp_path, capsys):
    photographs, measured = tmp_path / "photographs", tmp_path / "measured" / "one"
    photographs.mkdir()
    measured.mkdir(parents=True)
    picture = np.rint(255 * texture).astype(np.uint8)
    cv2.imwrite(str(photographs / "a.png"), picture)
    cv2.imwrite(str(measured / "sharp_srgb.png"), picture)
    disparity = np.tile(np.linspace(10, 30, 192, dtype=np.float32), (192, 1))
    np.savez(measured / "disparity.npz", disparity=disparity)
    monkeypatch.setattr(raw["samples"], "SIDE_PX", SIDE)
    steps = []
    for _ in range(2):
        monkeypatch.setattr(
            sys,
            "argv",
            f"fit --photographs {photographs} --measured {measured.parent} --batch 4 --noises 1"
            f" --networks any --seconds 20 --out {tmp_path / 'state'}".split(),
        )
        raw["fit"].main()
        reached = json.loads((tmp_path / "state" / "reached.json").read_text())
        steps.append(reached["steps"]["any"])
    assert 0 < steps[0] < steps[1]
    assert max(path.stat().st_size for path in (tmp_path / "state").iterdir()) < 2**24
    assert "held back:" in capsys.readouterr().out
