"""Collection in other processes: weights by mailbox, no lost batches, no lock step."""

from toponav.collectors.mailbox import Mailbox, MailboxError
from toponav.collectors.mailbox_collector import MailboxCollector, Subscription
from toponav.collectors.patient_async_collector import PatientAsyncCollector
from toponav.collectors.staggered_episodes import StaggeredEpisodes

__all__ = [
    "Mailbox",
    "MailboxCollector",
    "MailboxError",
    "PatientAsyncCollector",
    "StaggeredEpisodes",
    "Subscription",
]
