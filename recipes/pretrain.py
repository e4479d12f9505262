"""Train the TC-network and the L-network on random walks.

    python recipes/pretrain.py maze=select
    python recipes/pretrain.py mazes=[maze1,maze2,maze3]
    python recipes/pretrain.py maze=maze1 init_from=runs/pretrain/select-...
    python recipes/pretrain.py maze=maze1 init_from=runs/... train.updates=0
    python recipes/pretrain.py resume=runs/pretrain/select-...

Other processes walk at random, this one learns from their frames: which views are
close in time (TC), and which action leads from one to the other (L). The run folder
gets ``networks.pt`` (both networks and their thresholds), ``metrics.csv``,
``curves.png``, TensorBoard files, the report against the truth (``report.json``,
``report.png``) and ``checkpoint.pt``, from which ``resume`` goes on.
"""

import time
from pathlib import Path

import torch
from torch.nn.utils import clip_grad_norm_
from tqdm import tqdm

from toponav.builders import (
    FRAME_KEYS,
    NETWORKS_FILE,
    Validation,
    collect_frames,
    collect_held_out,
    decisions_due,
    keep_freed_memory,
    learning_rate,
    make_autocast,
    make_device,
    make_frame_buffer,
    make_loggers,
    make_losses,
    make_optimizer,
    make_pair_source,
    require_finite,
    restore_training,
    save_networks,
    save_training,
    split_mazes,
    start_networks,
    summarize,
    write_history,
    write_measurements,
    write_reports,
)
from toponav.config import PretrainConfig
from toponav.launch import recipe


@recipe("pretrain")
def main(settings: PretrainConfig, folder: Path) -> None:
    """Collect, train, validate, calibrate, report."""
    train, mazes, started = settings.train, split_mazes(settings), time.monotonic()
    torch.manual_seed(settings.seed)
    torch.set_num_threads(train.threads or torch.get_num_threads())
    keep_freed_memory()
    device = make_device(settings.device)
    autocast = make_autocast(device, bf16=train.bf16)

    # The networks: fresh, of an earlier run, or as they were when this run was cut off.
    networks = start_networks(settings.model, settings.init_from, device=device)
    optimizer = make_optimizer(networks, train)
    generator = torch.Generator().manual_seed(settings.seed)
    done, history = 0, list[dict[str, float]]()
    if settings.resume:
        done, history = restore_training(folder, networks, optimizer, generator)
    before = history[-1]["seconds"] if history else 0.0

    # What they are measured on: episodes that no training sees.
    held_out = [collect_held_out(settings, maze, i) for i, maze in enumerate(mazes)]
    validate = Validation(settings, held_out, device=device, autocast=autocast)

    # Other processes walk; pairs of their frames train both networks.
    buffer = make_frame_buffer(settings)
    pairs = make_pair_source(
        settings.pairs, networks, buffer.storage, generator=generator, device=device
    )
    tc_loss, l_loss = make_losses(networks, mined=settings.pairs.mined)
    loggers = make_loggers(folder)
    decisions = 0

    def measure(number: int) -> dict[str, float]:
        seconds = before + time.monotonic() - started
        counts = {"update": number, "decisions": decisions, "seconds": seconds}
        return counts | validate(networks)

    def update(number: int) -> dict[str, float]:
        for group in optimizer.param_groups:
            group["lr"] = learning_rate(train, number)
        with autocast:
            tc_pairs, l_pairs = pairs()
            tc, locomotion = tc_loss(tc_pairs), l_loss(l_pairs)
        loss = tc["loss_tc"] + train.locomotion_coeff * locomotion["loss_locomotion"]
        optimizer.zero_grad()
        loss.backward()
        norm = clip_grad_norm_(networks.modules.parameters(), train.max_grad_norm)
        measured = {
            "loss_tc": float(tc["loss_tc"].detach()),
            "loss_locomotion": float(locomotion["loss_locomotion"].detach()),
            "train_tc_accuracy": float(tc["accuracy"]),
            "train_l_accuracy": float(locomotion["accuracy"]),
            "gradient_norm": float(norm),
        }
        require_finite(measured, number, folder)
        optimizer.step()
        return measured

    saved = time.monotonic()
    with (
        collect_frames(settings, needed=done < train.updates) as frames,
        tqdm(total=train.updates, initial=done, unit="update", smoothing=0.05) as bar,
    ):
        for number in range(done, train.updates):
            # Collect the decisions that are due before this update.
            while decisions < decisions_due(settings, number):
                bar.set_description(f"collect, {decisions:,} decisions")
                batch = next(frames).flatten().select(*FRAME_KEYS)
                buffer.extend(batch)
                decisions += len(batch)

            # Learn from pairs of all frames so far.
            measured = update(number)
            bar.set_description("train", refresh=False)
            bar.update()
            is_last = number + 1 == train.updates

            # Measure on the held-out episodes.
            if is_last or (number + 1) % settings.validate.every == 0:
                bar.set_description("validate")
                history.append(measure(number + 1) | measured)
                write_measurements(folder, loggers, history)
                last = history[-1]
                bar.set_postfix(
                    loss_tc=f"{last['loss_tc']:.3f}",
                    loss_l=f"{last['loss_locomotion']:.3f}",
                    tc=f"{last['tc_accuracy']:.1%}",
                    l=f"{last['l_accuracy']:.1%}",
                )

            # Save, now and then and at the end.
            if is_last or time.monotonic() - saved > train.save_every_s:
                save_training(
                    folder,
                    networks,
                    optimizer,
                    generator,
                    update=number + 1,
                    history=history,
                )
                saved = time.monotonic()
    if not history:  # No updates were wanted: the networks of `init_from` as they are.
        write_history(folder / "metrics.csv", [measure(0)])

    # Thresholds from random walks, the report against the truth, the networks.
    networks.modules.eval()
    figures = write_reports(folder, networks, validate, mazes, settings)
    save_networks(networks, folder / NETWORKS_FILE)
    print(summarize(figures, networks))
    minutes = (before + time.monotonic() - started) / 60
    print(
        f"{settings.collect.decisions:,} decisions, {train.updates:,} updates in "
        f"{minutes:.1f} minutes; written to {folder}"
    )


if __name__ == "__main__":
    main()
