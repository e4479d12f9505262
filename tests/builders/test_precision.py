"""Networks compute in bfloat16 where the processor does, and may."""

import pytest
import torch

from toponav.builders.processes import has_fast_bf16


@pytest.mark.parametrize(
    ("limit", "fast"),
    [
        ("", True),
        ("ALL", True),
        ("AVX512_CORE_BF16", True),
        ("AVX512_CORE", False),
        ("avx2", False),
    ],
)
def test_a_limit_for_onednn_counts(
    limit: str, fast: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(torch.cpu, "_is_avx512_bf16_supported", lambda: True)
    monkeypatch.setenv("ONEDNN_MAX_CPU_ISA", limit)
    assert has_fast_bf16(torch.device("cpu")) is fast


def test_a_processor_without_bf16_computes_in_float32(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv("ONEDNN_MAX_CPU_ISA", raising=False)
    monkeypatch.setattr(torch.cpu, "_is_avx512_bf16_supported", lambda: False)
    assert not has_fast_bf16(torch.device("cpu"))
