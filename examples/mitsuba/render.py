"""Draws the samples of a sampling map with Mitsuba 3: a client of `stein adapt --sampler-command`.

Reads the layer `samples` of the map: even numbers of samples to draw in each pixel.
Writes the new samples alone: the colour and the features albedo, normal and depth, each with its mean, the means of
both halves and the sample variance of the mean, and the number of samples in each pixel.
"""

import argparse
import sys

import numpy as np


def arguments():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--scene", help="Mitsuba XML file [default: a Cornell box with a glass ball and a metal ball]")
    parser.add_argument("--map", help="sampling map to draw")
    parser.add_argument("--spp", type=int, help="without a map: samples in every pixel, an even number")
    parser.add_argument("--size", default="256x256", help="without a map: width and height")
    parser.add_argument("--out", required=True, help="EXR file to write")
    parser.add_argument("--iteration", type=int, default=1, help="number of the iteration, which seeds the samples")
    parser.add_argument("--depth", type=int, default=12, help="longest path")
    parser.add_argument("--reference", action="store_true", help="write the colour alone")
    parser.add_argument("--variant", default="llvm_ad_rgb", help="Mitsuba variant: llvm_ad_rgb or cuda_ad_rgb")
    parser.add_argument("--chunk", type=int, default=1 << 20, help="samples to draw at once")
    return parser.parse_args()


def read_counts(path):
    """Samples to draw in each pixel."""
    bitmap = mi.Bitmap(path)
    names = [field.name for field in bitmap.struct_()]
    if "samples.V" not in names:
        sys.exit(f"{path}: has no channel samples.V, only {', '.join(names)}")
    values = np.array(bitmap)
    return values.reshape(bitmap.height(), bitmap.width(), -1)[:, :, names.index("samples.V")].astype(np.int64)


def load_scene(path, width, height):
    if path:
        scene = mi.load_file(path)
        size = scene.sensors()[0].film().size()
        if (size[0], size[1]) != (width, height):
            sys.exit(
                f"{path}: the film is of {size[0]}x{size[1]}, but {width}x{height} are asked for: "
                "give `stein adapt` that --size"
            )
        return scene
    box = mi.cornell_box()
    box["sensor"]["film"]["width"], box["sensor"]["film"]["height"] = width, height
    del box["small-box"], box["large-box"]
    place = mi.ScalarTransform4f
    box["glass"] = {
        "type": "sphere",
        "to_world": place().translate([0.35, -0.6, 0.35]).scale(0.4),
        "bsdf": {"type": "dielectric"},
    }
    metal = {"type": "roughconductor", "material": "Cu", "alpha": 0.15}
    box["metal"] = {"type": "sphere", "to_world": place().translate([-0.4, -0.55, -0.3]).scale(0.45), "bsdf": metal}
    return mi.load_dict(box)


def draw(scene, integrator, pixels, width, height, seed):
    """One sample for each entry of `pixels`: an array of values for each channel."""
    sensor = scene.sensors()[0]
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, len(pixels))
    index = mi.UInt32(pixels.astype(np.uint32))
    place = mi.Point2f(index % width, index // width) + sampler.next_2d()
    time = sensor.shutter_open() + sampler.next_1d() * sensor.shutter_open_time()
    ray, weight = sensor.sample_ray_differential(
        time, sampler.next_1d(), place / mi.Point2f(width, height), sampler.next_2d()
    )
    hit = scene.ray_intersect(ray)
    valid = hit.is_valid()
    albedo = dr.select(valid, hit.bsdf(ray).eval_diffuse_reflectance(hit), 0)
    normal = dr.select(valid, hit.sh_frame.n, 0)
    # Towards the viewer, whichever side is hit.
    normal = dr.select(dr.dot(normal, ray.d) > 0, -normal, normal)
    depth = dr.select(valid, hit.t, 0)
    color = integrator.sample(scene, sampler, ray)[0] * weight
    channels = [color.x, color.y, color.z, albedo.x, albedo.y, albedo.z, normal.x, normal.y, normal.z, depth]
    dr.eval(channels)
    return [np.array(channel, dtype=np.float64) for channel in channels]


CHANNELS = [("", c) for c in "RGB"] + [("albedo", c) for c in "RGB"] + [("normal", c) for c in "XYZ"] + [("depth", "Z")]


def ranges(counts, most):
    """Runs of pixels that have no more than `most` samples together, but at least one pixel."""
    first, total = 0, 0
    for pixel, count in enumerate(counts):
        if total + count > most and pixel > first:
            yield first, pixel
            first, total = pixel, 0
        total += count
    yield first, len(counts)


def render(scene, counts, options):
    """Halves and variance of the mean of every channel; NaN where there are no samples."""
    height, width = counts.shape
    counts = counts.reshape(-1)
    integrator = mi.load_dict({"type": "path", "max_depth": options.depth})
    half_a, half_b, variance = (np.full((len(CHANNELS), counts.size), np.nan) for _ in range(3))
    for chunk, (first, end) in enumerate(ranges(counts, options.chunk)):
        pairs = counts[first:end] // 2
        if pairs.sum() == 0:
            continue
        local = np.repeat(np.arange(end - first), pairs)
        halves = []
        for half in range(2):
            # Seeds of different iterations, chunks and halves never meet.
            seed = (options.iteration * 2 + half) * 65536 + chunk
            halves.append(draw(scene, integrator, first + local, width, height, seed))
            done = 100 * (first + (half + 1) / 2 * (end - first)) / counts.size
            print(f"iteration {options.iteration}: {done:.0f} %", file=sys.stderr)
        known = pairs > 0
        n = 2.0 * pairs[known]
        total = lambda values: np.bincount(local, values, end - first)[known]
        for channel in range(len(CHANNELS)):
            a, b = halves[0][channel], halves[1][channel]
            mean = np.zeros(end - first)
            mean[known] = (total(a) + total(b)) / n
            squares = total((a - mean[local]) ** 2) + total((b - mean[local]) ** 2)
            here = np.arange(first, end)[known]
            half_a[channel, here], half_b[channel, here] = total(a) / pairs[known], total(b) / pairs[known]
            variance[channel, here] = squares / (n * (n - 1))
    return half_a, half_b, variance


def write(path, counts, half_a, half_b, variance, color_only):
    height, width = counts.shape
    planes, names = [], []
    for index, (layer, suffix) in enumerate(CHANNELS[:3] if color_only else CHANNELS):
        parts = [("", (half_a[index] + half_b[index]) / 2)]
        if not color_only:
            parts += [("halfA", half_a[index]), ("halfB", half_b[index]), ("variance", variance[index])]
        for part, plane in parts:
            full = "_".join(word for word in (layer, part) if word)
            names.append(f"{full}.{suffix}" if full else suffix)
            planes.append(plane)
    names.append("samples")
    planes.append(counts.reshape(-1).astype(np.float64))
    image = np.stack(planes, axis=-1).reshape(height, width, -1).astype(np.float32)
    mi.Bitmap(image, mi.Bitmap.PixelFormat.MultiChannel, names).write(path)


if __name__ == "__main__":
    options = arguments()
    import mitsuba as mi

    mi.set_variant(options.variant)
    import drjit as dr

    if options.map:
        counts = read_counts(options.map)
    elif options.spp and options.spp % 2 == 0:
        width, height = map(int, options.size.split("x"))
        counts = np.full((height, width), options.spp)
    else:
        sys.exit("give a --map, or an even number --spp")
    scene = load_scene(options.scene, counts.shape[1], counts.shape[0])
    write(options.out, counts, *render(scene, counts, options), options.reference)
