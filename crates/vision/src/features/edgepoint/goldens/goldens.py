"""Makes goldens.safetensors: what PyTorch computes of two small images with the published weights of EdgePoint2.

    python3 goldens.py EDGEPOINT2/weights/S64.pth > goldens.safetensors

Needs torch, numpy and safetensors. The network is written out here from its layers; nothing is folded.
"""

import sys

import numpy
import torch
import torch.nn.functional as F
from safetensors.torch import save

EPSILON = 1e-5
TOP = 60


def picture(width, height):
    """Rectangles of random grey, blurred a little, with noise: whole numbers from 0 to 255."""
    random = numpy.random.default_rng(7)
    image = numpy.full((height, width), 110.0)
    for _ in range(60):
        x, y = random.integers(0, width), random.integers(0, height)
        w, h = random.integers(4, 24, 2)
        image[y : y + h, x : x + w] = random.integers(20, 236)
    wide = numpy.pad(image, 1, mode="edge")
    image = sum(wide[i : i + height, j : j + width] for i in range(3) for j in range(3)) / 9
    return numpy.clip(numpy.round(image + random.normal(0, 2, image.shape)), 0, 255)


class Network:
    def __init__(self, tensors):
        self.tensors = tensors

    def convolution(self, name, x, stride=1, padding=0, groups=1):
        bias = self.tensors.get(name + ".bias")
        return F.conv2d(x, self.tensors[name + ".weight"], bias, stride, padding, groups=groups)

    def normalization(self, name, x):
        mean, variance, weight, bias = (
            self.tensors[f"{name}.{what}"] for what in ("running_mean", "running_var", "weight", "bias")
        )
        return F.batch_norm(x, mean, variance, weight, bias, eps=EPSILON)

    def basic(self, name, x, stride=1, groups=1):
        x = self.convolution(name + ".layer.0", x, stride, 1, groups)
        return F.relu(self.normalization(name + ".layer.1", x))

    def residual(self, name, x):
        inside = F.relu(self.normalization(name + ".layer.1", self.convolution(name + ".layer.0", x, padding=1)))
        inside = self.normalization(name + ".layer.4", self.convolution(name + ".layer.3", inside, padding=1))
        has_skip = name + ".skip.weight" in self.tensors
        return F.relu(inside + (self.convolution(name + ".skip", x) if has_skip else x))

    def maps(self, grey):
        x = grey / 255
        x = (x - x.mean()) / torch.sqrt(x.var(correction=0) + EPSILON)
        x1 = self.residual("block1.2", self.basic("block1.1", self.basic("block1.0", x, stride=2)))
        quarter = F.avg_pool2d(x1, 2)
        x2 = self.residual("block2", F.avg_pool2d(quarter, 2))
        x3 = self.residual("block3", F.avg_pool2d(x2, 4))

        def larger(x, factor):
            return F.interpolate(x, scale_factor=factor, mode="bilinear", align_corners=False)

        features = torch.cat([quarter, larger(x2, 2), larger(x3, 8)], 1)
        features = self.convolution("desc_head.0", features)
        features = self.basic("desc_head.1", features, groups=features.shape[1] // 16)
        descriptors = self.convolution("desc_head.2", features)
        scores = self.convolution("conv1", x1)
        scores = scores + larger(self.convolution("conv2", x2), 4) + larger(self.convolution("conv3", x3), 16)
        for layer in (0, 2):
            scores = F.relu(self.convolution(f"score_head.{layer}", scores, padding=1))
        scores = F.pixel_shuffle(self.convolution("score_head.4", scores, padding=1), 2)
        return {"x1": x1, "quarter": quarter, "x2": x2, "x3": x3, "scores": scores}, descriptors


def keypoints(network, image):
    """The best keypoints (x, y, score) and their descriptors. Sides that are not multiples of 32 are continued."""
    height, width = image.shape
    grey = torch.tensor(numpy.pad(image, ((0, -height % 32), (0, -width % 32)), mode="edge"), dtype=torch.float32)
    maps, descriptors = network.maps(grey[None, None])
    scores = maps["scores"][0, 0]
    peaks = (scores == F.max_pool2d(scores[None, None], 5, 1, 2)[0, 0]) & (scores > -5)
    peaks[:4] = peaks[:, :4] = False
    peaks[height - 4 :] = False
    peaks[:, width - 4 :] = False
    y, x = torch.nonzero(peaks, as_tuple=True)
    best = scores[y, x].topk(min(TOP, len(y)))
    x, y = x[best.indices], y[best.indices]
    size = torch.tensor(grey.shape[::-1])
    places = (torch.stack([x, y], 1) + 0.5) / size * 2 - 1
    at = F.grid_sample(descriptors, places[None, None].float(), mode="bilinear", align_corners=False)
    points = torch.stack([x, y, best.values], 1)
    return maps, points, F.normalize(at[0, :, 0].T, dim=1)


tensors = {name: t.float() for name, t in torch.load(sys.argv[1], "cpu").items() if t.is_floating_point()}
network = Network(tensors)
large = picture(96, 64)
odd = large[:53, :83]
goldens, points, descriptors = keypoints(network, large)
_, odd_points, odd_descriptors = keypoints(network, odd)
goldens = {name: tensor[0] for name, tensor in goldens.items()}
goldens.update(
    image=torch.tensor(large, dtype=torch.float32),
    points=points,
    descriptors=descriptors,
    odd_points=odd_points,
    odd_descriptors=odd_descriptors,
)
sys.stdout.buffer.write(save({name: tensor.detach().float().contiguous() for name, tensor in goldens.items()}))
