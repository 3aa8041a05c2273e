"""Train a small network on a mix of robots and appliances with PyTorch.

    python 06_train.py --out data/mix
    python 06_train.py --out data/mix --small    # seconds
"""

from __future__ import annotations

import argparse
from pathlib import Path

import gcbench as gb
import torch
from gcbench.renderer.dataset.torch import TorchDataset, pad_collate
from torch import nn
from torch.utils.data import ConcatDataset, DataLoader


def network() -> nn.Module:
    """Two RGB images to the flow from the first to the second, in pixels."""
    return nn.Sequential(
        nn.Conv2d(6, 16, 7, stride=2, padding=3), nn.ReLU(),
        nn.Conv2d(16, 32, 5, stride=2, padding=2), nn.ReLU(),
        nn.Conv2d(32, 32, 3, padding=1), nn.ReLU(),
        nn.Conv2d(32, 2, 3, padding=1),
        nn.Upsample(scale_factor=4, mode="bilinear", align_corners=False),
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("data/mix"))
    parser.add_argument("--small", action="store_true", help="few small images")
    options = parser.parse_args()

    small = {"frames": 5, "width": 64, "height": 48} if options.small else {}
    parts = []
    for robot in ("owi535", "microwave") if options.small else ("owi535", "microwave", "drawer"):
        config = gb.RenderConfig(robot=robot, stream="train", **small)
        gb.render_dataset(config, n=2 if options.small else 50, out=options.out / robot,
                          workers=1 if options.small else None)
        parts.append(TorchDataset(
            gb.open_dataset(options.out / robot), images=("rgb", "flow"),
            state=("intrinsics", "joint_positions"), masks=True))

    # Models have different numbers of joints: `pad_collate` pads them and adds a mask.
    loader = DataLoader(ConcatDataset(parts), batch_size=4, shuffle=True, collate_fn=pad_collate,
                        generator=torch.Generator().manual_seed(0))
    torch.manual_seed(0)
    model = network()
    optimizer = torch.optim.Adam(model.parameters(), lr=3e-4)
    step, losses = 0, []
    while step < 100:
        for batch in loader:
            images = batch["rgb"].float().flatten(1, 2) / 255 - 0.5  # [batch 6 H W]
            flow, valid = batch["flow"][:, 0], batch["flow_valid"][:, 0]
            error = torch.linalg.vector_norm(model(images) - flow, dim=1)
            loss = error[valid].mean() if valid.any() else 0.0 * error.sum()
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            losses.append(loss.item())
            if step % 20 == 0:
                joints = batch["joint_positions_mask"].any(dim=1).sum(dim=1).tolist()
                print(f"step {step:3}: {loss:.3f} px; joints of the models: {joints}")
            if (step := step + 1) == 100:
                break
    print(f"mean error {sum(losses[:20]) / 20:.3f} px in the first 20 steps, "
          f"{sum(losses[-20:]) / 20:.3f} px in the last 20")


if __name__ == "__main__":
    main()
