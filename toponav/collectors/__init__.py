"""Collection in other processes: weights by mailbox, no lost batches."""

from toponav.collectors.mailbox import (
    Mailbox as Mailbox,
    MailboxCollector as MailboxCollector,
    MailboxError as MailboxError,
    PatientAsyncCollector as PatientAsyncCollector,
    Subscription as Subscription,
)
from toponav.collectors.staggered_episodes import StaggeredEpisodes as StaggeredEpisodes
