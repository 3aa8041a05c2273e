"""ResNet-18 (He et al., CVPR 2016) without its classifier."""

# pyright: basic
from __future__ import annotations

from .torch_runtime import F, Tensor, nn, torch


class ResNet18(nn.Module):
    """The network; its parameters have the names that checkpoints of PyTorch use."""

    def __init__(self, width: int = 64) -> None:
        """`width`: channels of the first layers; the last have eight times as many."""
        super().__init__()
        self.conv1 = nn.Conv2d(3, width, 7, 2, 3, bias=False)
        self.bn1 = nn.BatchNorm2d(width)
        channels = width
        for k in range(1, 5):
            outputs = width * 2 ** (k - 1)
            blocks = [_Block(channels, outputs, 1 if k == 1 else 2), _Block(outputs, outputs, 1)]
            self.add_module(f"layer{k}", nn.Sequential(*blocks))
            channels = outputs
        # the order that convolutions in bfloat16 compute in
        self.to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]

    def forward(self, image: Tensor) -> list[Tensor]:
        """Return features at 1/2, 1/4 .. 1/32 of an image [B 3 H W]."""
        out = [F.relu(self.bn1(self.conv1(image)))]
        x = F.max_pool2d(out[0], 3, 2, 1)
        for k in range(1, 5):
            x = self.get_submodule(f"layer{k}")(x)
            out.append(x)
        return out


class _Block(nn.Module):
    def __init__(self, inputs: int, outputs: int, stride: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(inputs, outputs, 3, stride, 1, bias=False)
        self.bn1 = nn.BatchNorm2d(outputs)
        self.conv2 = nn.Conv2d(outputs, outputs, 3, 1, 1, bias=False)
        self.bn2 = nn.BatchNorm2d(outputs)
        self.downsample = None
        if stride != 1 or inputs != outputs:
            self.downsample = nn.Sequential(
                nn.Conv2d(inputs, outputs, 1, stride, bias=False), nn.BatchNorm2d(outputs)
            )

    def forward(self, x: Tensor) -> Tensor:
        around = x if self.downsample is None else self.downsample(x)
        return F.relu(self.bn2(self.conv2(F.relu(self.bn1(self.conv1(x))))) + around)
