"""What learns from collected batches, and where they come from."""

from toponav.training.checkpoints import (
    ExplorationState as ExplorationState,
    restore_exploration as restore_exploration,
    restore_training as restore_training,
    save_exploration as save_exploration,
    save_training as save_training,
)
from toponav.training.consumers import (
    BestPolicy as BestPolicy,
    finish as finish,
    make_consumers as make_consumers,
    make_learner as make_learner,
    needed_keys as needed_keys,
    trained_policies as trained_policies,
)
from toponav.training.continued_training import (
    ContinuedTraining as ContinuedTraining,
    LocomotionFinetuner as LocomotionFinetuner,
)
from toponav.training.episode_log import (
    EpisodeLog as EpisodeLog,
    Row as Row,
    mean_of as mean_of,
)
from toponav.training.explore_collector import (
    make_explore_collector as make_explore_collector,
    make_mailbox as make_mailbox,
)
from toponav.training.explore_worker import (
    make_worker_env as make_worker_env,
    make_worker_policy as make_worker_policy,
    prepare_worker as prepare_worker,
)
from toponav.training.explorer import (
    COVERAGE_LEVELS as COVERAGE_LEVELS,
    Explorer as Explorer,
    make_coverage as make_coverage,
    make_explore_env as make_explore_env,
    make_explorer as make_explorer,
    publish as publish,
)
from toponav.training.ground_training import GroundRules as GroundRules
from toponav.training.map_growth import MapGrowth as MapGrowth
from toponav.training.pair_trainer import (
    PairTrainer as PairTrainer,
    make_pair_trainer as make_pair_trainer,
    require_finite as require_finite,
)
from toponav.training.place_training import (
    OffsetRules as OffsetRules,
    PlaceRules as PlaceRules,
)
from toponav.training.pretraining import (
    Validation as Validation,
    decisions_due as decisions_due,
    learning_rate as learning_rate,
    make_pretrainer as make_pretrainer,
)
from toponav.training.room import (
    require_explore_room as require_explore_room,
    require_pretrain_room as require_pretrain_room,
)
from toponav.training.steering_practice import (
    PracticeRules as PracticeRules,
    SteeringPractice as SteeringPractice,
)
