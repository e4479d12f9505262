import pytest
import torch
from hypothesis import given, strategies as st
from tensordict import TensorDict

from toponav.objectives import SequenceMinibatches


def numbered(rows: int, steps: int) -> TensorDict:
    number = torch.arange(rows * steps).reshape(rows, steps)
    following = {"reward": torch.zeros(rows, steps, 1)}
    return TensorDict({"number": number, "next": following}, [rows, steps])


@given(
    rows=st.integers(1, 5),
    pieces=st.integers(1, 4),
    length=st.integers(1, 5),
    num=st.integers(1, 4),
)
def test_a_pass_meets_every_sequence_once_and_whole(
    rows: int, pieces: int, length: int, num: int
) -> None:
    num = min(num, rows * pieces)
    minibatches = SequenceMinibatches(length, num_minibatches=num, seed=0)
    parts = list(minibatches(numbered(rows, pieces * length)))
    assert len(parts) == num
    sizes = [len(part) for part in parts]
    assert max(sizes) - min(sizes) <= 1
    dealt = torch.cat(parts)["number"]
    assert (dealt[:, 0] % length == 0).all()
    assert (dealt.diff(dim=1) == 1).all()
    assert sorted(dealt.flatten().tolist()) == list(range(rows * pieces * length))


def orders(minibatches: SequenceMinibatches, num_passes: int) -> list[list[int]]:
    batch = numbered(8, 4)
    return [
        torch.cat(list(minibatches(batch)))["number"][:, 0].tolist()
        for _ in range(num_passes)
    ]


def test_the_order_is_new_each_time_and_the_seed_s_own() -> None:
    first, second = orders(SequenceMinibatches(2, num_minibatches=3, seed=1), 2)
    assert first != second
    torch.manual_seed(99)
    again = orders(SequenceMinibatches(2, num_minibatches=3, seed=1), 2)
    assert again == [first, second]
    assert orders(SequenceMinibatches(2, num_minibatches=3, seed=2), 1) != [first]


def test_it_goes_on_where_its_state_was_taken() -> None:
    minibatches = SequenceMinibatches(2, num_minibatches=3, seed=1)
    orders(minibatches, 1)
    state = minibatches.state_dict()
    expected = orders(minibatches, 2)
    other = SequenceMinibatches(2, num_minibatches=3, seed=7)
    other.load_state_dict(state)
    assert orders(other, 2) == expected


def test_what_lies_under_next_stays_behind() -> None:
    batch = numbered(2, 4)
    (part,) = SequenceMinibatches(4, num_minibatches=1, seed=0)(batch)
    assert list(part.keys()) == ["number"]
    assert "next" in batch


def test_what_does_not_fit_is_refused() -> None:
    with pytest.raises(ValueError, match="must be at least 1, got 0 and 3"):
        SequenceMinibatches(0, num_minibatches=3)
    minibatches = SequenceMinibatches(50, num_minibatches=3)
    with pytest.raises(ValueError, match=r"120 decisions, got 50"):
        list(minibatches(numbered(1, 120)))
    with pytest.raises(ValueError, match="at most the batch's 2 sequences, got 3"):
        list(minibatches(numbered(1, 100)))
