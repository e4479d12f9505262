"""Builders: environments, networks, maps and collectors from settings."""

from toponav.builders.beside_map import (
    MAP_FILE as MAP_FILE,
    POSES_FILE as POSES_FILE,
    find_beside as find_beside,
    mend_beside as mend_beside,
    name_contents as name_contents,
    next_path as next_path,
    put_beside as put_beside,
)
from toponav.builders.collection import (
    FRAME_KEYS as FRAME_KEYS,
    Rollout as Rollout,
    collect_frames as collect_frames,
    collect_held_out as collect_held_out,
    collect_rollout as collect_rollout,
    collect_walks as collect_walks,
    frames_that_fit as frames_that_fit,
    make_frame_buffer as make_frame_buffer,
    make_walk_policy as make_walk_policy,
    taken_meanwhile as taken_meanwhile,
)
from toponav.builders.edge_trials import (
    TRIALS_FILE as TRIALS_FILE,
    load_trials as load_trials,
    save_trials as save_trials,
)
from toponav.builders.kept_layout import keep_layout as keep_layout
from toponav.builders.map_poses import load_poses as load_poses
from toponav.builders.maps import (
    action_effects as action_effects,
    make_map as make_map,
    map_thresholds as map_thresholds,
    threshold_of as threshold_of,
)
from toponav.builders.mazes import (
    engine_world as engine_world,
    make_env as make_env,
    make_layout as make_layout,
)
from toponav.builders.navigation import (
    AgentKnowledge as AgentKnowledge,
    GoalPlaces as GoalPlaces,
    GroundTruth as GroundTruth,
    load_exploration as load_exploration,
    load_knowledge as load_knowledge,
    make_goal_places as make_goal_places,
    make_navigation_env as make_navigation_env,
    make_practice_env as make_practice_env,
    require_same_maze as require_same_maze,
)
from toponav.builders.networks import (
    NETWORKS_FILE as NETWORKS_FILE,
    PACKAGE_NETWORKS as PACKAGE_NETWORKS,
    Networks as Networks,
    Novelty as Novelty,
    for_inference as for_inference,
    load_networks as load_networks,
    make_empty_novelty as make_empty_novelty,
    make_networks as make_networks,
    networks_path as networks_path,
    require_same_model as require_same_model,
    save_networks as save_networks,
    start_networks as start_networks,
)
from toponav.builders.places import (
    PLACES_FILE as PLACES_FILE,
    MapNetworks as MapNetworks,
    load_places as load_places,
    save_places as save_places,
)
from toponav.builders.policies import (
    load_new_policy as load_new_policy,
    load_policy as load_policy,
    save_policy as save_policy,
)
from toponav.builders.pretraining import (
    prepare_networks as prepare_networks,
    pretraining_decisions as pretraining_decisions,
    pretraining_folder as pretraining_folder,
    pretraining_overrides as pretraining_overrides,
    settings_key as settings_key,
)
from toponav.builders.processes import (
    CollectionError as CollectionError,
    collect_batches as collect_batches,
    has_fast_bf16 as has_fast_bf16,
    keep_freed_memory as keep_freed_memory,
    make_autocast as make_autocast,
    make_device as make_device,
    prepare_process as prepare_process,
    running_episodes as running_episodes,
    seed_of as seed_of,
    start_collector as start_collector,
    stop_collector as stop_collector,
    track_apart as track_apart,
)
from toponav.builders.protocols import (
    NETWORKS as NETWORKS,
    POLICY as POLICY,
    Check as Check,
    Consumer as Consumer,
    Learner as Learner,
    RewardMethod as RewardMethod,
    World as World,
)
from toponav.builders.ray_cluster import (
    join_cluster as join_cluster,
    require_cluster as require_cluster,
)
from toponav.builders.steering import (
    load_controller as load_controller,
    make_controller as make_controller,
    save_controller as save_controller,
)
from toponav.builders.threads import (
    ThreadGuard as ThreadGuard,
    one_thread as one_thread,
    threads_apart as threads_apart,
)
