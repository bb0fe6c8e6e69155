def _ways_to_regularise() -> tuple[str, ...]:
    """Return what is compared: graph cuts only where they are installed."""
    return ("semiglobal", "graphcut") if find_spec("maxflow") else ("semiglobal",)


def _some_subspaces(stack: PsfStack) -> tuple[SubspaceBank, SubspaceFrame]:
    """Return a bank of the thesis' size and projections: what the numbers are takes no time."""
    random = np.random.default_rng(0)
    size = (_THESIS_BASIS, _THESIS_BASIS)
    form = random.standard_normal(size).astype(np.float32)
    bank = SubspaceBank(
        stack=stack,
        patch_px=_THESIS_PATCH_PX,
        rank=_THESIS_FILTERS,
        basis=np.zeros((_THESIS_PATCH_PX**2, _THESIS_BASIS), np.float32),
        forms=np.broadcast_to(form, (len(stack), *size)),
        truncation_error=0.0,
        noise=0.0,
        mask_digest="",
        learned_from="nothing",
    )
    shape = tuple(side + _THESIS_PATCH_PX for side in _PLACES)
    projections = random.standard_normal((*_PLACES, _THESIS_BASIS)).astype(np.float32)
    return bank, SubspaceFrame(projections, PatchGrid.covering(shape, _THESIS_PATCH_PX, 1))
