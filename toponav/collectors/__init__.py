"""Collection in other processes: weights by mailbox, no lost batches; Ray."""

from toponav.collectors.mailbox import (
    Mailbox as Mailbox,
    MailboxCollector as MailboxCollector,
    MailboxError as MailboxError,
    PatientAsyncCollector as PatientAsyncCollector,
    Subscription as Subscription,
)
from toponav.collectors.patience import Patience as Patience
from toponav.collectors.prepared_collector import (
    PreparedCollector as PreparedCollector,
)
from toponav.collectors.ray_collector import LastingRayCollector as LastingRayCollector
from toponav.collectors.ray_mailbox import RayMailbox as RayMailbox
from toponav.collectors.staggered_episodes import StaggeredEpisodes as StaggeredEpisodes
