"""Collection in other processes: weights by mailbox, no lost batches."""

from toponav.collectors.mailbox import Mailbox as Mailbox, MailboxError as MailboxError
from toponav.collectors.mailbox_collector import (
    MailboxCollector as MailboxCollector,
    PatientAsyncCollector as PatientAsyncCollector,
    Subscription as Subscription,
)
from toponav.collectors.staggered_episodes import StaggeredEpisodes as StaggeredEpisodes
