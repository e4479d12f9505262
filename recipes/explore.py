"""Explore a maze out of curiosity: the main job.

    python recipes/explore.py maze=maze3 reward.alpha=0.2
    python recipes/explore.py maze=maze1 pretrained=runs/pretrain/maze1-...
    python recipes/explore.py reward=rnd
    python recipes/explore.py collect.backend=ray ray.address=<host>:6379
    python recipes/explore.py resume=runs/explore/maze3-...
    python recipes/explore.py -m maze=maze1,maze2,maze3 seed=0,1,2

The novelty reward needs networks that judge how close in time two views are: those of
``pretrained``, or of a pre-training with the same settings, or of one that starts now.
Then other processes explore with the newest policy, and this one hands every batch to
the consumers: the learner, the map, the log. The run folder gets ``metrics.csv``,
``episodes.csv``, TensorBoard files, ``curves.png`` and ``map.png`` while it runs,
``policy.pt``, ``networks.pt``, ``evaluation.csv`` and ``episode.mp4`` at the end, and
``checkpoint.pt``, from which ``resume`` continues. A topological map grows from the
same views: ``map.zip``, with ``topology.png``, ``map.csv`` that judges it, and
``map_poses.npy``, the ground truth about it, which no agent reads. ``map_views.bin``
has the views of its waypoints; the checkpoint needs it.
"""

from toponav.interrupts import catch_early

catch_early(__name__)

import time
from pathlib import Path

import torch

from toponav import builders, methods, reports, training
from toponav.config import ExploreConfig
from toponav.launch import recipe, require_pretraining
from toponav.runs import stop_requests

PRETRAIN = Path(__file__).with_name("pretrain.py")


@recipe("explore")
def main(settings: ExploreConfig, folder: Path) -> None:
    """Find networks if they are needed, explore, evaluate."""
    require_pretraining(settings, folder)
    schedule = reports.explore_schedule(settings, folder)
    builders.prepare_process(threads=settings.threads)
    builders.require_cluster(settings)

    # The world, policies that see nothing in it, networks if this reward needs them.
    world, networks = methods.make_world(settings), None
    training.require_explore_room(settings, world, folder)
    builders.keep_layout(folder, settings.maze, world.layout)
    for hint in reports.large_maze_hints(settings, world):
        print(hint)
    baselines = reports.start_baselines(settings, world)
    if settings.pretrained or methods.REWARDS[settings.reward.name].needs_networks:
        schedule.begin(reports.PRETRAIN)
        networks = builders.prepare_networks(
            settings, world, folder, PRETRAIN, environment=schedule.environment()
        )
    settings = settings.resolved(None if networks is None else networks.model)

    # What explores, and the consumers of what it does: learner, reward, map, log.
    torch.manual_seed(settings.seed)
    state = training.ExplorationState()
    reward = methods.make_reward(settings, world, networks)
    learner = training.make_learner(settings, world, reward, state, folder)
    explorer = training.Explorer(learner.policy, reward, networks)
    log, consumers = training.make_consumers(
        settings, world, networks, learner, reward, state, folder
    )
    episodes = None
    if settings.resume:
        episodes = training.restore_exploration(folder, state, consumers)
        # A run that is over goes on if it is given more decisions.
        state.count(0, state.seconds, settings.collect)
        if state.progress < 1:
            # Results of a run that was over are of fewer decisions, and not of it all.
            (folder / "evaluation.csv").unlink(missing_ok=True)
    else:
        with stop_requests():
            training.save_exploration(folder, state, consumers)

    # Other processes explore, here or on other machines, with weights from a mailbox.
    mailbox = training.make_mailbox(settings, explorer, state.versions)
    collector = training.make_explore_collector(
        settings,
        world,
        mailbox,
        keep=training.needed_keys(consumers),
        decisions=state.decisions,
        episodes=episodes,
    )
    watch = {"max_idle_s": settings.collect.max_idle_s}
    batches = builders.collect_batches(collector, **watch)
    report = reports.ExplorationReport(
        settings, world, folder, state, log, consumers, schedule, baselines
    )
    saving = reports.Timer(settings.report.save_every_s)
    started = time.monotonic() - state.seconds
    with stop_requests() as stop:
        try:
            # Where every episode is, if they can be resumed.
            episodes = builders.running_episodes(collector, **watch)
            while state.progress < 1 and not stop.requested:
                # Collect: what the others did with a policy of a moment ago.
                batch = next(batches)
                seconds = time.monotonic() - started
                state.count(batch.numel(), seconds, settings.collect)

                # Hand it to each consumer in turn; the learner updates the policy.
                measured: dict[str, float] = {}
                for consumer in consumers.values():
                    measured |= consumer.extend(batch)

                # Publish: the others fetch new weights before their next rollout.
                versions = training.publish(mailbox, explorer, consumers.values())
                state.versions |= versions

                # Report, and save between two batches.
                report.update(measured, batch.numel())
                if saving.is_due():
                    episodes = builders.running_episodes(collector, **watch)
                    training.save_exploration(folder, state, consumers, episodes)
            episodes = builders.running_episodes(collector, **watch)
            training.save_exploration(folder, state, consumers, episodes)
        except builders.CollectionError:
            # Better an older state than one that has lost its episodes.
            if episodes is None:
                training.save_exploration(folder, state, consumers)
            if not stop.requested:
                raise
        finally:
            report.close()
            builders.stop_collector(collector)

    # Whole episodes of what was learned, beside what is done once no more batches come:
    # the last map, the fine-tuning.
    schedule.begin(reports.EVALUATE)
    policies = training.trained_policies(settings, world, learner, consumers)
    training.finish(consumers, folder, beside=False)
    with reports.evaluating(
        settings, world, explorer, policies, show=schedule.part()
    ) as evaluation:
        training.finish(consumers, folder, beside=True, progress=schedule.part())
        learned = evaluation.result()
    if networks is not None:
        builders.save_networks(networks, folder / builders.NETWORKS_FILE)

    # The policy with more reward is kept.
    if reward.selection_metric is not None:
        metric = reward.selection_metric
        learned.sort(key=lambda one: one.mean(metric), reverse=True)
    builders.save_policy(folder, policies[learned[0].policy].state_dict())
    blind = baselines.rows(settings, explorer)
    rows = reports.write_evaluation(folder, learned, blind)
    reports.write_episode_video(folder, world, learned[0])
    schedule.end()
    print(reports.summarize_evaluation(world.name, rows))
    print(
        f"{state.decisions:,} decisions in {state.seconds / 60:.1f} minutes of "
        f"exploring; this command took {schedule.minutes:.1f} minutes from start to "
        f"end; written to {folder}"
    )


if __name__ == "__main__":
    main()
