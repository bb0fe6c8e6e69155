"""Outlines of random things: how much of every pixel each of them covers."""

import math
from collections.abc import Callable

import torch

_STICKS = 6
_CORNERS = 5


def uniform(low: float, high: float, *shape: int, device: torch.device) -> torch.Tensor:
    """Random numbers between two."""
    return low + (high - low) * torch.rand(*shape, device=device)


def log_uniform(low: float, high: float, *shape: int, device: torch.device) -> torch.Tensor:
    """Random numbers whose logarithms lie evenly between two."""
    return uniform(math.log(low), math.log(high), *shape, device=device).exp()


def smooth_noise(
    count: int, shape: tuple[int, int], slope: torch.Tensor, device: torch.device
) -> torch.Tensor:
    """Noise [count, rows, columns] whose amplitude falls with a power of frequency; deviation 1."""
    rows, columns = shape
    down = torch.fft.fftfreq(rows, device=device)[:, None]
    right = torch.fft.rfftfreq(columns, device=device)
    frequency = torch.hypot(down, right).clamp(min=1 / max(shape))
    amplitude = frequency ** (-slope.view(-1, 1, 1))
    white = torch.fft.rfft2(torch.randn(count, rows, columns, device=device))
    noise = torch.fft.irfft2(white * amplitude, s=shape)
    noise = noise - noise.mean((1, 2), keepdim=True)
    return noise / noise.std((1, 2), keepdim=True).clamp(min=1e-6)


def random_covers(count: int, shape: tuple[int, int], device: torch.device) -> torch.Tensor:
    """Covers [count, rows, columns], 0 to 1, of things of random kinds and places."""
    kinds = torch.multinomial(
        torch.tensor([share for share, _ in _KINDS]), count, replacement=True
    ).to(device)
    covers = torch.zeros(count, *shape, device=device)
    for kind, (_, draw) in enumerate(_KINDS):
        chosen = torch.nonzero(kinds == kind)[:, 0]
        if len(chosen):
            covers[chosen] = draw(len(chosen), shape, device)
    return covers


def _turned_places(
    count: int, shape: tuple[int, int], device: torch.device, upright: float = 0.4
) -> tuple[torch.Tensor, torch.Tensor]:
    """Places of pixels, in the axes of things that lie anywhere and are turned by any angle."""
    rows, columns = shape
    down = torch.arange(rows, device=device, dtype=torch.float32).view(1, -1, 1)
    right = torch.arange(columns, device=device, dtype=torch.float32).view(1, 1, -1)
    down = down - uniform(0, rows, count, 1, 1, device=device)
    right = right - uniform(0, columns, count, 1, 1, device=device)
    angle = uniform(0, math.pi, count, 1, 1, device=device)
    few = torch.rand(count, 1, 1, device=device) < upright
    angle = torch.where(few, angle.div(math.pi / 2).round() * (math.pi / 2), angle)
    return angle.cos() * down - angle.sin() * right, angle.sin() * down + angle.cos() * right


def _filled(distance: torch.Tensor) -> torch.Tensor:
    """Cover of what lies within an outline, from the distance to it."""
    return (0.5 - distance).clamp(0, 1)


def _box(y: torch.Tensor, x: torch.Tensor, high: torch.Tensor, wide: torch.Tensor) -> torch.Tensor:
    return torch.maximum(y.abs() - high, x.abs() - wide)


def _sizes(count: int, low: float, high: float, device: torch.device) -> torch.Tensor:
    return log_uniform(low, high, count, 1, 1, device=device)


def _rods(count: int, shape: tuple[int, int], device: torch.device) -> torch.Tensor:
    y, x = _turned_places(count, shape, device)
    bend = uniform(-1.5e-3, 1.5e-3, count, 1, 1, device=device)
    return _filled(
        _box(y, x + bend * y**2, _sizes(count, 40, 400, device), _sizes(count, 0.8, 12, device))
    )


def _gratings(count: int, shape: tuple[int, int], device: torch.device) -> torch.Tensor:
    """Parallel rods, or nets of them."""
    y, x = _turned_places(count, shape, device)
    half = _sizes(count, 0.8, 5, device)
    spacing = 2 * half * uniform(1.8, 8, count, 1, 1, device=device) + 4

    def across(place: torch.Tensor) -> torch.Tensor:
        return (torch.remainder(place + spacing / 2, spacing) - spacing / 2).abs() - half

    net = torch.rand(count, 1, 1, device=device) < 0.5
    bars = torch.where(net, torch.minimum(across(x), across(y)), across(x))
    ends = _box(y, x, _sizes(count, 30, 200, device), _sizes(count, 30, 200, device))
    return _filled(torch.maximum(bars, ends))


def _boxes(count: int, shape: tuple[int, int], device: torch.device) -> torch.Tensor:
    y, x = _turned_places(count, shape, device)
    return _filled(_box(y, x, _sizes(count, 6, 110, device), _sizes(count, 6, 110, device)))


def _ellipses(count: int, shape: tuple[int, int], device: torch.device) -> torch.Tensor:
    y, x = _turned_places(count, shape, device)
    high, wide = _sizes(count, 6, 90, device), _sizes(count, 6, 90, device)
    return _filled((torch.hypot(y / high, x / wide) - 1) * torch.minimum(high, wide))


def _polygons(count: int, shape: tuple[int, int], device: torch.device) -> torch.Tensor:
    y, x = _turned_places(count, shape, device)
    far = torch.full_like(y + x, -1e6)
    for corner in range(_CORNERS):
        angle = uniform(0, 2 * math.pi / _CORNERS, count, 1, 1, device=device)
        angle = angle + corner * 2 * math.pi / _CORNERS
        side = angle.cos() * y + angle.sin() * x - _sizes(count, 8, 80, device)
        far = torch.maximum(far, side)
    return _filled(far)


def _leaves(count: int, shape: tuple[int, int], device: torch.device) -> torch.Tensor:
    """Where smooth noise is high: foliage, with holes of all sizes."""
    noise = smooth_noise(count, shape, uniform(1.3, 2.6, count, device=device), device)
    limit = uniform(-0.3, 1.3, count, 1, 1, device=device)
    return ((noise - limit) * uniform(3, 8, count, 1, 1, device=device) + 0.5).clamp(0, 1)


def _sticks(count: int, shape: tuple[int, int], device: torch.device) -> torch.Tensor:
    """Segments between random points, as of chairs, ladders, cables and branches."""
    y, x = _turned_places(count, shape, device)
    nearest = torch.full_like(y + x, 1e6)
    reach = _sizes(count, 15, 130, device)
    last = [reach * uniform(-1, 1, count, 1, 1, device=device) for _ in range(2)]
    for _ in range(_STICKS):
        joined = torch.rand(count, 1, 1, device=device) < 0.5
        first = [
            torch.where(joined, place, reach * uniform(-1, 1, count, 1, 1, device=device))
            for place in last
        ]
        last = [reach * uniform(-1, 1, count, 1, 1, device=device) for _ in range(2)]
        dy, dx = last[0] - first[0], last[1] - first[1]
        along = ((y - first[0]) * dy + (x - first[1]) * dx) / (dy**2 + dx**2).clamp(min=1)
        along = along.clamp(0, 1)
        gap = torch.hypot(y - first[0] - along * dy, x - first[1] - along * dx)
        nearest = torch.minimum(nearest, gap)
    return _filled(nearest - _sizes(count, 0.8, 9, device))


def _outlines(count: int, shape: tuple[int, int], device: torch.device) -> torch.Tensor:
    """Frames and rings."""
    y, x = _turned_places(count, shape, device)
    high, wide = _sizes(count, 12, 100, device), _sizes(count, 12, 100, device)
    ring = (torch.hypot(y / high, x / wide) - 1) * torch.minimum(high, wide)
    round_ = torch.rand(count, 1, 1, device=device) < 0.4
    distance = torch.where(round_, ring, _box(y, x, high, wide))
    return _filled(distance.abs() - _sizes(count, 0.8, 9, device))


_Draw = Callable[[int, tuple[int, int], torch.device], torch.Tensor]
# How often each kind is drawn.
_KINDS: tuple[tuple[float, _Draw], ...] = (
    (0.2, _rods),
    (0.1, _gratings),
    (0.16, _boxes),
    (0.1, _ellipses),
    (0.1, _polygons),
    (0.08, _leaves),
    (0.16, _sticks),
    (0.1, _outlines),
)
