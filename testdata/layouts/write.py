"""Writes the files of this folder: for every layout in crates/exr/layouts one small set as the renderer writes it.

No renderer has made the pixels. They only tell layers and channels apart: channel c of a file set's k-th layer holds
k + c/10 and a small slope; k counts from 1, c from 0. Names, suffixes, parts, types and the attributes that tell the
renderer are those of real files. `expected.toml` says what each layer is to be taken for.

    pip install numpy OpenEXR
    python testdata/layouts/write.py
"""

from pathlib import Path

import numpy as np
import OpenEXR

HERE = Path(__file__).parent
WIDTH, HEIGHT = 8, 6
HALF, FLOAT = "f2", "f4"

# Spellings of the suffixes of a colour.
UPPER = {}
LOWER = {"R": "r", "G": "g", "B": "b", "A": "a", "X": "x", "Y": "y", "Z": "z"}
WORDS = {"R": "red", "G": "green", "B": "blue", "A": "alpha"}


class Writer:
    """Writes files of one set and numbers their layers."""

    def __init__(self, folder):
        self.folder = HERE / folder
        self.folder.mkdir(exist_ok=True)
        self.layers = 0

    def channels(self, layers, suffixes, kind):
        """Channels of layers such as "albedo:RGB". "u:" is a channel without a suffix, "id:=u4" has a type."""
        channels = {}
        for layer in layers:
            self.layers += 1
            name, _, letters = layer.partition(":")
            letters, _, own_kind = letters.partition("=")
            dot = "." if name else ""
            for c, letter in enumerate(letters):
                channels[f"{name}{dot}{suffixes.get(letter, letter)}"] = self.plane(c, own_kind or kind)
            if not letters:
                channels[name] = self.plane(0, own_kind or kind)
        return channels

    def plane(self, c, kind):
        y, x = np.mgrid[0:HEIGHT, 0:WIDTH]
        slope = (x + y) / 128
        return (self.layers + c / 10 + slope).astype(kind)

    def write(self, name, layers, attributes=None, suffixes=UPPER, kind=FLOAT):
        """Writes a file of one part."""
        OpenEXR.File(header(attributes), self.channels(layers, suffixes, kind)).write(str(self.folder / name))

    def write_parts(self, name, parts, attributes=None, suffixes=UPPER, kind=FLOAT):
        """Writes a file of several parts, each with its name, layers and view. The first one has the attributes."""
        written = []
        for part, layers, *view in parts:
            own = header(None if written else attributes) | {"view": eye for eye in view}
            written.append(OpenEXR.Part(own, self.channels(layers, suffixes, kind), part))
        OpenEXR.File(written).write(str(self.folder / name))

    def write_each(self, ending, files, attributes=None, kind=FLOAT):
        """Writes one file for each pair of a stem and the letters of its plain layer."""
        for stem, letters in files.items():
            self.write(f"{stem}{ending}", [f":{letters}"], attributes, kind=kind)


def header(attributes):
    return {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage} | (attributes or {})


def in_group(group, layers):
    return [f"{group}{layer}" for layer in layers]


def own_parts(layers):
    """Parts that are named like the one layer in them."""
    return [(layer.partition(":")[0], [layer]) for layer in layers]


def native():
    set = Writer("native")
    features = ["albedo:RGB", "normal:XYZ", "depth:Z", "visibility:V", "caustic:RGB"]
    colors = ["", "halfA", "halfB", "variance"]
    noise = [f"{name}_{part}:{letters}" for name, letters in [("albedo", "RGB"), ("depth", "Z")]
             for part in ("halfA", "halfB", "variance")]
    set.write("all.exr", [f"{name}:RGB" for name in colors] + features + noise, {"samples": "16"})
    set.write("usual_names.exr",
              [":RGBA", "mse:RGB", "alb:RGB", "alb_var:RGB", "N:XYZ", "Z:", "P:XYZ", "samples:", "crypto00:RGBA",
               "diffuse:RGB", "diffuse_mse:RGB", "RGBA_key:RGB", "objectId:=u4", "uv:UV", "beauty_denoised:RGB"],
              suffixes=LOWER, kind=HALF)
    set.write("no_variance.exr",
              ["beauty:RGB", "Variance:RGB", "RelativeVariance:RGB", "noiseLevel:RGB", "noise:", "m2_beauty:RGB",
               "Debug Sample Count:X", "albedo:RGB", "denoising albedo:RGB"])
    set.write("luminance.exr", [":Y", "depth:Z"], kind=HALF)
    # Each group has a colour with layers of its own.
    set.write("groups.exr", in_group("v1.", ["beauty:RGB", "halfA:RGB", "halfB:RGB", "albedo:RGB"])
              + in_group("v2.", ["beauty:RGB", "variance:RGB", "normal:XYZ"]))


def pbrt():
    gbuffer = [":RGB", "Albedo:RGB", "P:XYZ", "dzdx:", "dzdy:", "N:XYZ", "Ns:XYZ", "u:", "v:", "Variance:RGB",
               "RelativeVariance:RGB"]
    attributes = {"samplesPerPixel": 16, "renderTimeSeconds": 1.5}
    Writer("pbrt").write("gbuffer.exr", gbuffer, attributes, kind=HALF)
    old = [":RGB", "Albedo:RGB", "dzdx:", "dzdy:", "Variance:RGB", "RelativeVariance:RGB"]
    old += [f"{name}{axis}:" for name in ("P", "N", "Ns") for axis in "xyz"]
    Writer("pbrt_old").write("gbuffer.exr", old, attributes, kind=HALF)


def mitsuba():
    set = Writer("mitsuba")
    attributes = {"generatedBy": "Mitsuba version 3.9.1"}
    aovs = ["img:RGBA", "albedo:RGB", "dd.y:T", "nn:XYZ", "pos:XYZ", "uv:UV", "shape:I"]
    set.write("aov.exr", [":RGB"] + aovs, attributes, kind=HALF)
    nested = ["nested:XYZ"] + in_group("nested.", aovs)
    set.write("moment_of_aov.exr", [":RGB"] + nested + in_group("m2_", nested), attributes)
    set.write("moment.exr", [":RGB", "nested:XYZ", "m2_nested:XYZ"], attributes)
    set.write("aov_of_moment.exr",
              [":RGBA", "img:RGBA", "img.raw:XYZ", "img.m2_raw:XYZ", "albedo:RGB", "dd:T", "sh_normal:XYZ"], attributes)
    set.write("xyz.exr", [":XYZ"], attributes)


def cycles():
    set = Writer("cycles")
    blender = {"BlenderMultiChannel": "Blender V2.55.1 and newer"}
    samples = {"cycles.ViewLayer.samples": "16"}
    data = ["Denoising Normal:XYZ", "Denoising Albedo:RGB", "Denoising Depth:Z"]
    new = ["Combined:RGBA", "Depth:Z", "Normal:XYZ", "Position:XYZ", "Vector:XYZW", "Diffuse Direct:RGB",
           "Diffuse Color:RGB", "Glossy Color:RGB", "Environment:RGB", "Debug Sample Count:X", "CryptoObject00:rgba",
           "Noisy Image:RGBA", *data, "Combined_key:RGB"]
    matte = {"cryptomatte/542cafa/name": "ViewLayer.CryptoObject"}
    set.write_parts("5_0.exr", own_parts(in_group("ViewLayer.", new)), blender | samples | matte)
    few = ["Combined:RGBA", "Depth:Z", *data]
    both = in_group("ViewLayer.", few) + in_group("fg.", few)
    set.write_parts("two_view_layers.exr", own_parts(both), blender | samples | {"cycles.fg.samples": "8"})
    # A 4.x file of two view layers and the compositor's result.
    set.write("4_5_composite.exr", ["Composite.Combined:RGBA", *both], blender | samples, kind=HALF)
    set.write("4_5_only_composite.exr", ["Composite.Combined:RGBA"], blender)
    set.write("2_90.exr",
              in_group("View Layer.", ["Combined:RGBA", "DiffDir:RGB", "DiffCol:RGB", "IndexOB:X", "Noisy Image:RGBA",
                                       *data, "Denoising Shadowing:X", "Denoising Variance:RGB",
                                       "Denoising Intensity:X"]),
              blender | {"cycles.View Layer.samples": "16"})
    eyes = [layer.replace(":", f".{eye}:") for eye in ("left", "right") for layer in in_group("ViewLayer.", few)]
    set.write("stereo.exr", eyes, blender | samples | {"multiView": ["left", "right"]})

    old = ["Combined:RGBA", "Depth:Z", "Emit:RGB", "Vector:XYZW", "Denoising Shadow A:XYV", "Denoising Shadow B:XYV"]
    noisy = data + [layer.replace(":", " Variance:") for layer in [*data, "Denoising Image:RGB"]]
    set = Writer("cycles_2_79")
    set.write("2_79.exr", in_group("RenderLayer.", [*old, *noisy, "Denoising Image:RGB"]), blender)
    set.write("2_80.exr", in_group("interior.", [*old, *noisy, "Noisy Image:RGBA"]), blender, kind=HALF)


def renderman():
    noise = ["mse:RGB", "albedo:RGB", "albedo_mse:RGB", "normal:RGB", "normal_var:RGB", "zfiltered:", "zfiltered_var:",
             "diffuse_mse:RGB", "specular_mse:RGB", "forward:XY", "backward:XY", "sampleCount:"]
    lights = ["diffuse:RGB", "specular:RGB"]
    attributes = {"rman_version": "26.2"}
    set = Writer("renderman")
    set.write("ci.0001.exr", ["Ci:RGB", "a:", *lights, *noise], attributes, LOWER)
    set.write("rgba.0001.exr", [":RGBA", "mse:RGB", "albedo:RGB", "albedo_var:RGB", "sampleCount:"], None, LOWER, HALF)
    set.write("even_odd.0001.exr", ["Ci:RGB", "Ci_even:RGB", "Ci_odd:RGB", "normal:XYZ", "normal_even:XYZ",
                                    "normal_odd:XYZ"], attributes, LOWER)
    set = Writer("renderman_classic")
    set.write("shot.0001.exr", ["Ci:RGB", "a:", *lights, "subsurface:RGB"], suffixes=LOWER)
    set.write("shot_variance.0001.exr", noise, suffixes=LOWER)


def arnold():
    set = Writer("arnold")
    attributes = {"arnold/version": "7.3.2.1", "arnold/aovs/N/filter": "closest_filter"}
    set.write("noice.exr",
              [":RGBA", "variance:RGB", "denoise_albedo:RGB", "denoise_albedo_noisy:RGB", "N:RGB", "N_noice:RGB", "Z:",
               "Z_noice:", "P:XYZ", "ID:=u4", "crypto_object00:RGBA", "diffuse:RGB", "diffuse_variance:RGB",
               "RGBA_key:RGB", "motionvector:XY"], attributes)
    # Prepared for noice by a script: without attributes.
    set.write("prepared.exr", [":RGBA", "variance:RGB", "denoise_albedo_noice:RGB", "N:XYZ", "Z:"], kind=HALF)


def tungsten():
    buffers = {"color": "RGB", "albedo": "RGB", "normal": "RGB", "depth": "Y", "visibility": "Y"}
    for prefix in ("", "box_"):
        files = {f"{prefix}{name}{part}": letters for name, letters in buffers.items()
                 for part in ("", "Variance", "A", "B") if not prefix or name != "visibility"}
        Writer("tungsten").write_each(".exr", files, kind=HALF)


def nori():
    buffers = {"": "RGB", "_albedo": "RGB", "_normal": "RGB", "_depth": "RGB"}
    files = {f"scene{name}{part}": letters for name, letters in buffers.items() for part in ("", "_variance")}
    Writer("nori").write_each(".exr", files, {"comments": "Generated by Nori"})


def bcd():
    set = Writer("bcd")
    set.write("image.exr", [":RGBA"], kind=HALF)
    set.write("image_cov.exr", [f"Bin_{i:04}:" for i in range(6)])
    set.write("image_hist.exr", [f"Bin_{i:04}:" for i in range(61)])


def appleseed():
    set = Writer("appleseed")
    software = {"Software": "appleseed 2.1.0-beta"}
    files = {"": "RGBA", ".albedo": "RGB", ".normal": "XYZ", ".depth": "Z", ".diffuse": "RGB"}
    set.write_each(".exr", {f"box{name}": letters for name, letters in files.items()}, software, HALF)
    parts = [("beauty", [":RGBA"]), ("albedo", [":RGB"]), ("normal", [":XYZ"]), ("depth", [":ZA"]),
             ("glossy", [":RGB"]), ("pixel_variation", [":RGB"])]
    set.write_parts("multi_part.exr", parts, software)


def luxcore():
    outputs = {"rgb": "RGB", "albedo": "RGB", "avgn": "RGB", "depth": "RGB", "noise": "RGB", "alpha": "RGB",
               "rg0": "RGB", "rg1": "RGB"}
    set = Writer("luxcore")
    set.write_each(".exr", {f"s1_{name}": letters for name, letters in outputs.items()})
    set.write_each(".exr", {"RGB_IMAGEPIPELINE": "RGB", "ALBEDO": "RGB", "AVG_SHADING_NORMAL": "RGB",
                            "DEPTH": "RGB"})


def vray():
    set = Writer("vray")
    attributes = {"vrayInfo/vraybuild": "6.20.00"}
    maya = [":RGBA", "effectsResult:RGB", "diffuse:RGB", "reflect:RGB", "GI:RGB", "noiseLevel:RGB", "defocusAmount:RGB",
            "normals:XYZ", "bumpNormals:XYZ", "zDepth:Z", "renderID:I=u4", "cryptomatte00:RGBA", "velocity:XYZ"]
    set.write("maya.exr", maya, attributes, WORDS, HALF)
    set.write("max.exr", [":RGB", "VRayDiffuseFilter:RGB", "VRayNormals:RGB", "VRayZDepth:RGB", "VRayLighting:RGB"])


def redshift():
    layers = [("rgba", [":RGBA"]), ("DiffuseFilter", ["DiffuseFilter:RGB"]), ("N", ["N:XYZ"]), ("Z", ["Z:"]),
              ("BumpNormals", ["BumpNormals:XYZ"]), ("DiffuseLighting", ["DiffuseLighting:RGB"]),
              ("Cryptomatte00", ["Cryptomatte00:RGBA"])]
    Writer("redshift").write_parts("beauty.exr", layers, suffixes=WORDS, kind=HALF)


def karma():
    layers = [":RGBA", "albedo:RGB", "N:XYZ", "hitPz:", "hitP:XYZ", "combineddiffuse:RGB", "C_key:RGB", "primid:=u4",
              "beautyunshadowed:RGB", "cputime:"]
    Writer("karma").write("beauty.exr", layers, kind=HALF)


def altus():
    set = Writer("altus")
    layers = [":RGB", "alb:RGB", "nrm:XYZ", "pos:XYZ", "vis:RGB", "cau:RGB", "extra:RGB"]
    for buffer in ("b0", "b1"):
        set.write(f"room.{buffer}.0001.exr", layers)


def oidn():
    set = Writer("oidn")
    set.write_each(".exr", {"room.hdr": "RGB", "room.alb": "RGB", "room.nrm": "RGB", "plain.hdr": "RGB",
                            "plain.alb": "RGB"})


def odd_ones():
    """Files that no layout is for, but every reader meets."""
    set = Writer("odd")
    two_eyes = {"multiView": ["left", "right"]}
    layers = [":RGB", "albedo:RGB", "depth:Z"]
    # The first view has no name in the channels, the other one comes first: `right.albedo.R`.
    set.write("stereo.exr", layers + ["right:RGB", "right.albedo:RGB", "right.depth:Z"], two_eyes)
    set.write_parts("views_in_parts.exr", [(f"{part}.{eye}", [":RGB"], eye) for part in ("rgba", "albedo")
                                            for eye in ("left", "right")])
    # OpenEXR's library refuses two parts of one name, some other writers do not.
    set.write_parts("two_parts_of_one_name.exr", [("main", [":RGB"]), ("mayn", ["albedo:RGB", "normal:XYZ"])])
    path = set.folder / "two_parts_of_one_name.exr"
    path.write_bytes(path.read_bytes().replace(b"mayn", b"main"))


if __name__ == "__main__":
    for write_set in (native, pbrt, mitsuba, cycles, renderman, arnold, tungsten, nori, bcd, appleseed, luxcore, vray,
                      redshift, karma, altus, oidn, odd_ones):
        write_set()
