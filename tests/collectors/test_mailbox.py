import threading
import time

import pytest
import torch
from torch import Tensor, nn

from toponav.collectors import Mailbox, MailboxError


def filled(value: float, size: int = 4) -> dict[str, Tensor]:
    return {"weight": torch.full((size,), value), "count": torch.tensor(int(value))}


def test_a_reader_gets_what_was_published_last_and_its_version() -> None:
    mailbox, mine = Mailbox({"policy": filled(0)}), filled(9)
    assert mailbox.pull("policy", mine) == 0
    assert mine["weight"].tolist() == [0, 0, 0, 0]
    assert mailbox.publish("policy", filled(1)) == 1
    assert mailbox.publish("policy", filled(2)) == 2
    assert mailbox.version("policy") == 2
    assert mailbox.pull("policy", mine) == 2
    assert mine["weight"].tolist() == [2, 2, 2, 2]
    assert mine["count"] == 2


def test_each_name_has_a_version_of_its_own() -> None:
    mailbox = Mailbox({"policy": filled(0), "networks": filled(0)})
    assert mailbox.names == ("policy", "networks")
    mailbox.publish("networks", filled(1))
    assert (mailbox.version("policy"), mailbox.version("networks")) == (0, 1)


def test_versions_go_on_where_an_earlier_run_was() -> None:
    mailbox = Mailbox({"policy": filled(0)}, versions={"policy": 7})
    assert mailbox.pull("policy", filled(9)) == 7
    assert mailbox.publish("policy", filled(1)) == 8


def test_parameters_and_buffers_of_a_module_travel_without_a_graph() -> None:
    one, other = (nn.Sequential(nn.Linear(2, 3), nn.BatchNorm1d(3)) for _ in range(2))
    one[1].running_mean.fill_(0.5)
    mailbox = Mailbox({"networks": one})
    mailbox.pull("networks", other)
    for name, value in other.state_dict().items():
        assert torch.equal(value, one.state_dict()[name]), name
    assert other[0].weight.requires_grad
    assert other[0].weight.is_leaf


def test_later_changes_of_a_module_do_not_leak_out() -> None:
    module = nn.Linear(1, 1)
    mailbox = Mailbox({"policy": module})
    before = module.weight.item()
    nn.init.constant_(module.weight, before + 1)
    mine = nn.Linear(1, 1)
    mailbox.pull("policy", mine)
    assert mine.weight.item() == before


@pytest.mark.parametrize(
    ("name", "given", "message"),
    [
        ("polcy", filled(0), "name must be one of policy, got 'polcy'"),
        (
            "policy",
            {"weight": torch.ones(4)},
            "count in 'policy' must be .* got nothing",
        ),
        ("policy", filled(0, size=5), r"weight in 'policy' must be \[4\], got \[5\]"),
        (
            "policy",
            filled(0) | {"more": torch.ones(1)},
            "more in 'policy' must be nothing",
        ),
    ],
)
def test_what_does_not_fit_is_refused(
    name: str, given: dict[str, Tensor], message: str
) -> None:
    mailbox = Mailbox({"policy": filled(0)})
    with pytest.raises(MailboxError, match=message):
        mailbox.publish(name, given)
    with pytest.raises(MailboxError, match=message):
        mailbox.pull(name, given)
    assert mailbox.version("policy") == 0


def test_a_reader_waits_for_a_publication_in_progress_until_a_timeout() -> None:
    mailbox = Mailbox({"policy": filled(0)})
    mailbox._stamps["policy"] += 1  # as if the publisher died while it wrote
    with pytest.raises(MailboxError, match=r"complete within 0\.01 s, got none"):
        mailbox.pull("policy", filled(0), timeout_s=0.01)


SIZE = 100_000


def _publish_for_a_while(mailbox: Mailbox, seconds: float) -> None:
    torch.set_num_threads(1)
    end, value = time.monotonic() + seconds, 0
    while time.monotonic() < end:
        value += 1
        mailbox.publish("policy", filled(value, SIZE))


def test_no_copy_is_torn_while_a_thread_publishes() -> None:
    mailbox, mine = Mailbox({"policy": filled(0, SIZE)}), filled(0, SIZE)
    writer = threading.Thread(target=_publish_for_a_while, args=(mailbox, 0.5))
    writer.start()
    seen = set()
    while writer.is_alive():
        version = mailbox.pull("policy", mine)
        assert mine["weight"].unique().tolist() == [version]
        # Another tensor of the same publication, written after the first.
        assert mine["count"] == version
        seen.add(version)
    assert len(seen) > 3
