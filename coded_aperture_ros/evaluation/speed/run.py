class SpeedBenchmark:
    """All measurements, as a list of short steps, and what came of them.

    Parameters
    ----------
    setting : Setting
    extent : Extent

    Raises
    ------
    InputError
        If the bank cannot be learned, or a frame is smaller than its window.
    """

    def __init__(self, setting: Setting, extent: Extent) -> None:
        self.setting, self.extent = setting, extent
        self._banks: dict[int, FilterBank] = {}
        self._rates: list[Rates] = []
        self._runs: dict[tuple[str, Any], VideoRun] = {}
        self._filter_s: list[float] = []
        self._place_s: list[float] = []
        self._denoise_s: dict[int, list[float]] = {}

    def steps(self) -> list[Work]:
        """Return the work, to be done in this order; `results` is of all of it."""
        setting, extent = self.setting, self.extent
        main = [partial(self._measure, ("main", None), extent.frames)] * _MAIN_TURNS
        sizes: list[Any] = [("size", size) for size in extent.sizes]
        levels: list[Any] = [("levels", count) for count in extent.levels]
        threads: list[Any] = [("threads", count) for count in extent.threads]
        slow: list[Work] = [self._measure_filters, self._measure_places] * extent.repeats
        if setting.temporal_frames:
            for count in extent.denoised:
                slow += [partial(self._measure_denoising, count)] * extent.repeats
        cuts: list[Any] = [("regularize", how) for how in _ways_to_regularise()]
        return [
            *(partial(self._learn, count) for count in sorted({setting.levels, *extent.levels})),
            self._measure_rates,
            *main,
            self._measure_rates,
            *(step for keys in (sizes, levels, threads, cuts) for step in self._in_turns(keys)),
            *slow,
        ]

    def results(self) -> dict[str, Any]:
        """Return all numbers, ready for JSON; keys end in their unit where there is one."""
        return {
            "setting": dataclasses.asdict(self.setting) | {"mask": MASK, "noise": NOISE},
            "machine": dataclasses.asdict(self._machine()) | {"processors": processors()},
            "main": self._main_results(),
            "sizes": self._size_results(),
            "levels": self._level_results(),
            "threads": self._thread_results(),
            "comparison": self._comparison(),
        }

    # The work.

    def _learn(self, levels: int) -> None:
        config = LearnConfig(window_px=self.setting.window_px, rank=self.setting.rank)
        mask = Mask.named(MASK)
        self._banks[levels] = learn_bank(blur_stack(mask, levels), config, mask=mask)

    def _measure_rates(self) -> None:
        self._rates.append(machine_rates(self.setting.threads))

    def _in_turns(self, keys: Sequence[tuple[str, Any]]) -> list[Work]:
        """Share the frames of some runs among turns."""
        turns = min(_TURNS, self.extent.frames)
        counts = [len(part) for part in np.array_split(np.arange(self.extent.frames), turns)]
        steps: list[Work] = [partial(self._measure, key, n) for n in counts for key in keys]
        return [*steps, partial(self._close, keys)]

    def _measure(self, key: tuple[str, Any], frames: int) -> None:
        if key not in self._runs:
            self._runs[key] = self._new_run(*key)
        self._runs[key].measure(frames)

    def _close(self, keys: Sequence[tuple[str, Any]]) -> None:
        for key in keys:
            self._runs[key].close()

    def _new_run(self, kind: str, value: Any) -> VideoRun:
        setting, changes = self.setting, {}
        if kind in ("levels", "threads", "size"):
            setting = dataclasses.replace(setting, **{kind: value})
        elif kind == "regularize":
            changes = {"regularize": value}
        bank = self._banks[setting.levels]
        return VideoRun(bank, moving_frames(bank.stack, setting.size), setting, **changes)

    def _measure_filters(self) -> None:
        """Convolve the frame with a few of the thesis' filters, and sum their squares.

        OpenCV does that by Fourier transforms where filters are as large as these.
        """
        threads = self.setting.threads
        random = np.random.default_rng(0)
        frame = random.random(self.setting.size, dtype=np.float32)
        side = (_THESIS_PATCH_PX, _THESIS_PATCH_PX)
        kernel = random.standard_normal(side).astype(np.float32)
        sums = [np.zeros_like(frame) for _ in range(threads)]

        def convolve(thread: int) -> None:
            for _ in range(_FILTERS_TRIED):
                cv2.accumulateSquare(cv2.filter2D(frame, cv2.CV_32F, kernel), sums[thread])

        with opencv_threads(1):  # each of our threads has its own filters
            self._filter_s += _seconds_in_threads(convolve, threads, _TRIES)

    def _measure_places(self) -> None:
        """Find the energies of some places from a common basis as large as the thesis'."""
        threads = self.setting.threads
        bank, frame = _some_subspaces(self._banks[self.setting.levels].stack)

        def energies(thread: int) -> None:
            bank.energies(frame, NOISE)

        self._place_s += _seconds_in_threads(energies, threads, _TRIES)

    def _measure_denoising(self, count: int) -> None:
        stack = self._banks[self.setting.levels].stack
        frames = moving_frames(stack, self.setting.size, count)
        pictures = [np.rint(255 * frame).astype(np.uint8) for frame in frames]
        with opencv_threads(self.setting.threads):
            start = time.perf_counter()
            cv2.fastNlMeansDenoisingMulti(pictures, count // 2, count)
            self._denoise_s.setdefault(count, []).append(time.perf_counter() - start)

    # What came of it.

    def _machine(self) -> Rates:
        """Return the best of the rates: those between which other work disturbed least."""
        best = {
            name: max(getattr(rates, name) for rates in self._rates)
            for name in ("gemm_gflop_s", "copy_gb_s")
        }
        medians = {
            name: float(np.median([getattr(rates, name) for rates in self._rates]))
            for name in ("gemm_p50_gflop_s", "copy_p50_gb_s")
        }
        return Rates(threads=self.setting.threads, **best, **medians)

    def _main_results(self) -> dict[str, Any]:
        run, machine = self._runs["main", None], self._machine()
        work = FrameWork.of(self._banks[self.setting.levels], self.setting, run.shape, run.map_size)
        engine, total = run.stage_times(*ENGINE_STAGES), run.times()
        engine_bytes, all_bytes = (
            work.bytes_of(stages) for stages in (ENGINE_STAGES, list(work.stage_bytes))
        )
        return {
            "size": run.shape,
            "map_size": run.map_size,
            "stages": {stage: dataclasses.asdict(run.stage_times(stage)) for stage in run.stages},
            "engine": dataclasses.asdict(engine),
            "total": dataclasses.asdict(total),
            "frames_per_second": len(run.totals) / sum(run.totals),
            "memory": dataclasses.asdict(run.memory) if run.memory else None,
            "per_pixel": work.per_pixel(),
            "roofline": {
                "engine": dataclasses.asdict(
                    roofline(work.flop, engine_bytes, machine, engine.p50_ms)
                ),
                "frame": dataclasses.asdict(roofline(work.flop, all_bytes, machine, total.p50_ms)),
            },
        }

    def _size_results(self) -> dict[str, Any]:
        sizes = self.extent.sizes
        runs = [self._runs["size", size] for size in sizes]
        pixels = [float(size[0] * size[1]) for size in sizes]
        totals = [run.times().p50_ms for run in runs]
        engines = [run.stage_times(*ENGINE_STAGES).p50_ms for run in runs]
        first = totals[0] / pixels[0]
        return {
            "slope": fitted_slope(pixels, totals),
            "slope_engine": fitted_slope(pixels, engines),
            "rows": [
                {
                    "size": run.shape,
                    "map_size": run.map_size,
                    "total": dataclasses.asdict(run.times()),
                    "engine_p50_ms": engine,
                    "time_per_pixel_relative": total / count / first,
                }
                for run, total, engine, count in zip(runs, totals, engines, pixels, strict=True)
            ],
        }

    def _level_results(self) -> dict[str, Any]:
        counts = [float(count) for count in self.extent.levels]
        runs = [self._runs["levels", count] for count in self.extent.levels]
        totals = [run.times().p50_ms for run in runs]
        of_levels = [
            run.stage_times(*(s for s in LEVEL_STAGES if s in run.stages)).p50_ms for run in runs
        ]
        return {
            "exponent": fitted_slope(counts, totals),
            "exponent_of_level_stages": fitted_slope(counts, of_levels),
            "rows": [
                {
                    "levels": count,
                    "total": dataclasses.asdict(run.times()),
                    "level_stages_p50_ms": stages_ms,
                }
                for count, run, stages_ms in zip(self.extent.levels, runs, of_levels, strict=True)
            ],
        }

    def _thread_results(self) -> dict[str, Any]:
        runs = [self._runs["threads", count] for count in self.extent.threads]
        first, first_engine = runs[0].times(), runs[0].stage_times(*ENGINE_STAGES)
        return {
            "rows": [
                {
                    "threads": count,
                    "total": dataclasses.asdict(run.times()),
                    "speedup": first.over(run.times()),
                    "speedup_engine": first_engine.over(run.stage_times(*ENGINE_STAGES)),
                }
                for count, run in zip(self.extent.threads, runs, strict=True)
            ]
        }

    def _comparison(self) -> dict[str, Any]:
        run = self._runs["main", None]
        return {
            "thesis": self._thesis_results(run),
            "denoising": self._denoising_results(run) if self.setting.temporal_frames else None,
            "graph_cut": self._graph_cut_results(),
        }

    def _thesis_results(self, run: VideoRun) -> dict[str, Any]:
        setting, engine = self.setting, run.stage_times(*ENGINE_STAGES)
        filters = setting.levels * _THESIS_FILTERS
        tried = _FILTERS_TRIED * setting.threads
        pixels = setting.size[0] * setting.size[1]
        places = _PLACES[0] * _PLACES[1] * setting.threads
        grid = PatchGrid.covering(setting.size, setting.window_px, setting.stride_px)
        density = pixels / (grid.rows * grid.columns)
        unfactored = Times.of(self._filter_s, filters / tried)
        basis_s = np.multiply(self._filter_s, _THESIS_BASIS / tried)
        levels_s = np.multiply(self._place_s, pixels / places)
        factored = Times.of((basis_s + levels_s).tolist())

        def against(times: Times) -> dict[str, Any]:
            ratio = times.over(engine)
            per_place = {name: value / density for name, value in ratio.items()}
            return {"ratio": ratio, "ratio_per_place": per_place}

        return {
            "engine": dataclasses.asdict(engine),
            "pixels_per_patch": density,
            "unfactored": {
                "extrapolated": f"from {tried} filters on the whole frame to {filters}",
                "filters": filters,
                "times": dataclasses.asdict(unfactored),
                **against(unfactored),
            },
            "common_basis": {
                "extrapolated": (
                    f"from {tried} filters on the whole frame to {_THESIS_BASIS}, and from the "
                    f"energies of {places} pixels to {pixels}"
                ),
                "filters": _THESIS_BASIS,
                "filters_p50_ms": 1000 * float(np.median(basis_s)),
                "energies_p50_ms": 1000 * float(np.median(levels_s)),
                "times": dataclasses.asdict(factored),
                **against(factored),
            },
        }

    def _denoising_results(self, run: VideoRun) -> dict[str, Any]:
        own = run.stage_times(*TEMPORAL_STAGES)
        rows = []
        for count, seconds in self._denoise_s.items():
            times = Times.of(seconds)
            rows.append(
                {"frames": count, "times": dataclasses.asdict(times), "ratio": times.over(own)}
            )
        return {"still_and_temporal": dataclasses.asdict(own), "non_local_means": rows}

    def _graph_cut_results(self) -> dict[str, Any] | None:
        times = {
            how: self._runs["regularize", how].stage_times("regularise")
            for how in _ways_to_regularise()
        }
        if "graphcut" not in times:
            return None
        return {
            "semiglobal": dataclasses.asdict(times["semiglobal"]),
            "graphcut": dataclasses.asdict(times["graphcut"]),
            "ratio": times["graphcut"].over(times["semiglobal"]),
        }
