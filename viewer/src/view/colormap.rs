//! False colours. Values are from 0 to 1, and colours are sRGB-encoded, from 0 to 1.

use serde::{Deserialize, Serialize};

/// A scale of colours. The lightness of the first three changes evenly, so that colour-blind people can read them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Colormap {
    /// Blue, green, yellow (S. van der Walt and N. Smith).
    #[default]
    Viridis,
    /// Black, red, yellow (the same authors).
    Inferno,
    /// Black, violet, pale yellow (the same authors).
    Magma,
    /// Black to white.
    Grey,
    /// Blue, white, red (K. Moreland): for values with a sign.
    Diverging,
}

impl Colormap {
    /// All colormaps, in the order of the rows of [`table`].
    pub const ALL: [Self; 5] = [Self::Viridis, Self::Inferno, Self::Magma, Self::Grey, Self::Diverging];
    /// Colormaps for values without a sign.
    pub const SEQUENTIAL: [Self; 4] = [Self::Viridis, Self::Inferno, Self::Magma, Self::Grey];

    /// Returns the title that users read.
    pub fn title(self) -> &'static str {
        match self {
            Self::Viridis => "viridis",
            Self::Inferno => "inferno",
            Self::Magma => "magma",
            Self::Grey => "grey",
            Self::Diverging => "blue to red",
        }
    }

    /// Returns the colour of a value from 0 to 1.
    pub fn color(self, value: f32) -> [f32; 3] {
        let value = value.clamp(0.0, 1.0);
        match self {
            Self::Viridis => polynomial(&VIRIDIS, value),
            Self::Inferno => polynomial(&INFERNO, value),
            Self::Magma => polynomial(&MAGMA, value),
            Self::Grey => [value; 3],
            Self::Diverging => diverging(value),
        }
    }
}

/// Number of colours in a row of [`table`].
pub const STEPS: usize = 256;

/// Returns a row of colours for each of [`Colormap::ALL`], from the colour of 0 to the colour of 1.
pub fn table() -> Vec<[f32; 4]> {
    let row = |map: Colormap| {
        (0..STEPS).map(move |step| {
            let [r, g, b] = map.color(step as f32 / (STEPS - 1) as f32);
            [r, g, b, 1.0]
        })
    };
    Colormap::ALL.into_iter().flat_map(row).collect()
}

/// Polynomials of degree 6 that M. Zucker fitted to the maps of matplotlib; both are in the public domain.
const VIRIDIS: [[f32; 3]; 7] = [
    [0.277_727_33, 0.005_407_344_5, 0.334_099_8],
    [0.105_093_04, 1.404_613_5, 1.384_590_1],
    [-0.330_861_83, 0.214_847_56, 0.095_095_16],
    [-4.634_230_5, -5.799_101, -19.332_441],
    [6.228_27, 14.179_933, 56.690_55],
    [4.776_385, -13.745_145, -65.353_03],
    [-5.435_456, 4.645_852_6, 26.312_435],
];
const INFERNO: [[f32; 3]; 7] = [
    [0.000_218_940_37, 0.001_651_004_6, -0.019_480_899],
    [0.106_513_42, 0.563_956_44, 3.932_712_4],
    [11.602_493, -3.972_854, -15.942_394],
    [-41.703_995, 17.436_4, 44.354_145],
    [77.162_94, -33.402_36, -81.807_31],
    [-71.319_43, 32.626_064, 73.209_52],
    [25.131_126, -12.242_669, -23.070_325],
];
const MAGMA: [[f32; 3]; 7] = [
    [-0.002_136_485, -0.000_749_655_05, -0.005_386_128],
    [0.251_660_54, 0.677_523_24, 2.494_026_7],
    [8.353_717, -3.577_719_5, 0.314_467_9],
    [-27.668_734, 14.264_731, -13.649_213],
    [52.176_14, -27.943_606, 12.944_169],
    [-50.768_525, 29.046_583, 4.234_153],
    [18.655_705, -11.489_774, -5.601_961_6],
];

fn polynomial(coefficients: &[[f32; 3]; 7], value: f32) -> [f32; 3] {
    let channel =
        |index: usize| coefficients.iter().rev().fold(0.0, |sum, coefficient| sum * value + coefficient[index]);
    [0, 1, 2].map(|index| channel(index).clamp(0.0, 1.0))
}

/// Moreland, "Diverging color maps for scientific visualization" (2009): even steps in polar CIELAB (M, s, h) from (80,
/// 1.08, −1.1) over white, M = 88, to (80, 1.08, 0.5). The hue is bent as the saturation fades.
fn diverging(value: f32) -> [f32; 3] {
    const MAGNITUDE: f32 = 80.0;
    const WHITE: f32 = 88.0;
    const SATURATION: f32 = 1.08;
    let (end_hue, white_hue) = if value < 0.5 { (-1.1, -0.561) } else { (0.5, 1.061) };
    let away = (2.0 * value - 1.0).abs();
    let between = |white: f32, end: f32| white + (end - white) * away;
    lab_of_msh(between(WHITE, MAGNITUDE), SATURATION * away, between(white_hue, end_hue))
}

fn lab_of_msh(magnitude: f32, saturation: f32, hue: f32) -> [f32; 3] {
    let chroma = magnitude * saturation.sin();
    srgb_of_lab(magnitude * saturation.cos(), chroma * hue.cos(), chroma * hue.sin())
}

/// Converts CIELAB under D65 to sRGB.
fn srgb_of_lab(lightness: f32, a: f32, b: f32) -> [f32; 3] {
    const WHITE: [f32; 3] = [0.950_47, 1.0, 1.088_83];
    let y = (lightness + 16.0) / 116.0;
    let cube = |t: f32| if t > 6.0 / 29.0 { t.powi(3) } else { 3.0 * (6.0_f32 / 29.0).powi(2) * (t - 4.0 / 29.0) };
    let [x, y, z] = [WHITE[0] * cube(y + a / 500.0), WHITE[1] * cube(y), WHITE[2] * cube(y - b / 200.0)];
    let linear = [
        3.240_454_2 * x - 1.537_138_5 * y - 0.498_531_4 * z,
        -0.969_266 * x + 1.876_010_8 * y + 0.041_556 * z,
        0.055_643_4 * x - 0.204_025_9 * y + 1.057_225_2 * z,
    ];
    linear.map(|value| {
        let value = value.clamp(0.0, 1.0);
        if value <= 0.003_130_8 { 12.92 * value } else { 1.055 * value.powf(1.0 / 2.4) - 0.055 }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Ends and middle as published, in 255ths.
    #[test]
    fn the_maps_are_the_published_ones() {
        let published = [
            (Colormap::Viridis, [[68, 1, 84], [33, 145, 140], [253, 231, 37]]),
            (Colormap::Inferno, [[0, 0, 4], [188, 55, 84], [252, 255, 164]]),
            (Colormap::Magma, [[0, 0, 4], [183, 55, 121], [252, 253, 191]]),
            (Colormap::Diverging, [[59, 76, 192], [221, 221, 221], [180, 4, 38]]),
        ];
        for (map, colors) in published {
            for (value, color) in [0.0, 0.5, 1.0].into_iter().zip(colors) {
                let found = map.color(value).map(|channel| channel * 255.0);
                let close = found
                    .iter()
                    .zip(color)
                    .all(|(found, published): (&f32, i32)| (found - published as f32).abs() < 6.0);
                assert!(close, "{map:?} at {value}: {found:?}, published {color:?}");
            }
        }
    }

    #[test]
    fn the_table_holds_every_map() {
        let table = table();
        assert_eq!(table.len(), STEPS * Colormap::ALL.len());
        assert_eq!(table[3 * STEPS + 255], [1.0; 4]);
    }
}
