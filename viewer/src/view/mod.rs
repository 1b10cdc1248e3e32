//! The view: the layers that are shown, the camera, and how values become colours.

mod camera;
pub mod canvas;
pub mod colormap;
pub mod display;
pub mod legend;
pub mod numbers;

use std::collections::HashMap;

use eframe::egui::{Painter, Rect, Vec2};
use serde::{Deserialize, Serialize};

use crate::layer::{Kind, Layer, Range, Scale, Shown, range_of};
use colormap::Colormap;
use display::{Draw, Operation};

pub use camera::Camera;

/// How two layers are shown.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Compare {
    /// A alone.
    #[default]
    Single,
    /// A at the left and B at the right, both with the same pan and zoom.
    SideBySide,
    /// A at the left and B at the right of a line that can be dragged.
    Wipe,
    /// A and B, one after the other.
    Blink,
    /// A − B, averaged over the channels.
    Difference,
    /// (A − B)/(|B| + 0.01), averaged over the channels.
    Relative,
}

impl Compare {
    /// All ways, in the order of the toolbar.
    pub const ALL: [Self; 6] =
        [Self::Single, Self::SideBySide, Self::Wipe, Self::Blink, Self::Difference, Self::Relative];

    /// Returns the title that users read.
    pub fn title(self) -> &'static str {
        match self {
            Self::Single => "single",
            Self::SideBySide => "side by side",
            Self::Wipe => "wipe",
            Self::Blink => "blink",
            Self::Difference => "difference",
            Self::Relative => "relative",
        }
    }

    /// Returns the explanation that users read.
    pub fn about(self) -> &'static str {
        match self {
            Self::Single => "Shows layer A alone",
            Self::SideBySide => "Shows A at the left and B at the right, from the same place",
            Self::Wipe => "Shows A at the left and B at the right of a line that can be dragged",
            Self::Blink => "Shows A and B one after the other",
            Self::Difference => "Shows A − B, averaged over the channels",
            Self::Relative => "Shows (A − B)/(|B| + 0.01), averaged over the channels",
        }
    }
}

/// How scene-linear colour becomes the colour on a screen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Tone {
    /// The sRGB curve; values above 1 are white.
    #[default]
    Srgb,
    /// x^(1/γ).
    Gamma,
    /// x/(1 + x), then the sRGB curve.
    Reinhard,
    /// A filmic curve (Narkowicz's fit to ACES), then the sRGB curve.
    Filmic,
}

impl Tone {
    /// All curves, in the order of the menu.
    pub const ALL: [Self; 4] = [Self::Srgb, Self::Gamma, Self::Reinhard, Self::Filmic];

    /// Returns the title that users read.
    pub fn title(self) -> &'static str {
        match self {
            Self::Srgb => "sRGB",
            Self::Gamma => "gamma",
            Self::Reinhard => "Reinhard",
            Self::Filmic => "filmic (ACES)",
        }
    }
}

/// The channels that are shown.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Channel {
    /// All channels; numbers in false colour are their mean.
    #[default]
    All,
    /// The first channel.
    Red,
    /// The second channel.
    Green,
    /// The third channel.
    Blue,
}

impl Channel {
    /// All choices, in the order of the menu.
    pub const ALL: [Self; 4] = [Self::All, Self::Red, Self::Green, Self::Blue];

    /// Returns the title that users read.
    pub fn title(self) -> &'static str {
        match self {
            Self::All => "all",
            Self::Red => "R",
            Self::Green => "G",
            Self::Blue => "B",
        }
    }
}

/// How values become colours. All layers share these settings, except for the ranges.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Display {
    /// Exposure in stops: colours are multiplied by 2 to this power.
    pub exposure: f32,
    /// Offset that is added to colours after the exposure.
    pub offset: f32,
    /// γ of [`Tone::Gamma`].
    pub gamma: f32,
    /// The curve from scene-linear to the screen.
    pub tone: Tone,
    /// Channels that are shown.
    pub channel: Channel,
    /// Whether layer B is shown on the false-colour scale of layer A.
    pub shares_scale: bool,
    /// False colours of numbers that have no sign.
    pub colormap: Colormap,
    /// False-colour scales that the user has set, by the names of the layers.
    pub scales: HashMap<String, (Range, Scale)>,
}

impl Default for Display {
    fn default() -> Self {
        Self {
            exposure: 0.0,
            offset: 0.0,
            gamma: 2.2,
            tone: Tone::default(),
            channel: Channel::default(),
            shares_scale: false,
            colormap: Colormap::default(),
            scales: HashMap::new(),
        }
    }
}

impl Display {
    /// Returns the ends and the steps of a layer's false-colour scale.
    pub fn scale_of(&self, layer: &Layer) -> (Range, Scale) {
        let scale = match layer.description.kind {
            Kind::Scalar(scale) => scale,
            _ => Scale::Linear,
        };
        self.scales.get(layer.name()).copied().unwrap_or((layer.range, scale))
    }
}

/// A window of neighbours that is drawn over the image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Marked {
    /// Pixel in the middle of the window, [column, row].
    pub pixel: [u32; 2],
    /// Radius R of the window, in pixels.
    pub radius: u32,
    /// Neighbour that is explained, [column, row].
    pub neighbour: Option<[u32; 2]>,
}

/// The layers that are shown, and how they are shown.
#[derive(Debug)]
pub struct View {
    /// Layer A, by its name.
    pub layer: String,
    /// Layer B, by its name.
    pub other: Option<String>,
    /// Comparison of the two layers.
    pub compare: Compare,
    /// Position of the line of [`Compare::Wipe`], as a share of the width of the canvas, 0 to 1.
    pub wipe: f32,
    /// Pan and zoom.
    pub camera: Camera,
    /// Settings that turn values into colours.
    pub display: Display,
    /// Pixel under the pointer, [column, row].
    pub hovered: Option<[u32; 2]>,
    /// Pixel that was clicked, [column, row]: it stays the chosen one while the pointer moves on.
    pub pinned: Option<[u32; 2]>,
    /// Whether the camera moves to the pinned pixel if that is out of sight.
    pub reveals_pinned: bool,
    /// Window that the kernel panel explains.
    pub marked: Option<Marked>,
    /// Ends of the scale of a difference, with the identifiers of the two layers and the comparison that they belong
    /// to.
    difference: Option<([u64; 2], Compare, Range)>,
    slots: display::Slots,
}

impl View {
    /// Creates a view of the result, fitted into the canvas.
    ///
    /// # Errors
    /// As [`display::Slots::new`].
    pub fn new(display: Display) -> stein::Result<Self> {
        Ok(Self {
            layer: "result".into(),
            other: None,
            compare: Compare::Single,
            wipe: 0.5,
            camera: Camera::default(),
            display,
            hovered: None,
            pinned: None,
            reveals_pinned: false,
            marked: None,
            difference: None,
            slots: display::Slots::new()?,
        })
    }

    /// Begins a frame of a window whose render target has this format.
    pub fn begin_frame(&mut self, format: eframe::wgpu::TextureFormat) {
        self.slots.begin(format);
    }

    /// Draws the thumbnail of a layer, as the canvas would show the layer.
    pub fn paint_thumbnail(&self, painter: &Painter, rect: Rect, layer: &Layer) {
        self.paint_whole(painter, rect, layer, layer.thumbnail.clone());
    }

    /// Draws an image of a layer, fitted into a rectangle, in the colours of the layer.
    pub fn paint_whole(&self, painter: &Painter, rect: Rect, layer: &Layer, image: Shown) {
        let extent = image.image.extent;
        let scale = (rect.width() / extent.width as f32).min(rect.height() / extent.height as f32);
        let size = Vec2::new(extent.width as f32, extent.height as f32) * scale;
        let inner = Rect::from_center_size(rect.center(), size);
        let (first, step) = placed(painter, inner, scale);
        let draw = self.draw(layer, image, first, step);
        painter.add(self.slots.paint(inner, draw));
    }

    /// Draws any image, stretched to the width of a rectangle; numbers are on the given scale.
    pub fn paint_image(&self, painter: &Painter, rect: Rect, shown: Shown, kind: Kind, (range, scale): (Range, Scale)) {
        let (first, step) = placed(painter, rect, rect.width() / shown.image.extent.width as f32);
        let draw = Draw { channel: Channel::All, ..self.draw_on(shown, kind, (range, scale), first, step) };
        painter.add(self.slots.paint(rect, draw));
    }

    /// Fills a rectangle with the colour of one pixel, as the canvas would show it.
    pub fn paint_pixel(&self, painter: &Painter, rect: Rect, shown: Shown, [x, y]: [usize; 2]) {
        const STEP: f32 = 1e-6;
        let scale = (Range { low: 0.0, high: 1.0 }, Scale::Linear);
        let draw = Draw {
            channel: Channel::All,
            ..self.draw_on(shown, Kind::Color, scale, [x as f32 + 0.5, y as f32 + 0.5], STEP)
        };
        painter.add(self.slots.paint(rect, draw));
    }

    /// Returns the draw of an image with the settings of its layer.
    fn draw(&self, layer: &Layer, shown: Shown, first: [f32; 2], step: f32) -> Draw {
        self.draw_on(shown, layer.description.kind, self.display.scale_of(layer), first, step)
    }

    fn draw_on(&self, shown: Shown, kind: Kind, (range, scale): (Range, Scale), first: [f32; 2], step: f32) -> Draw {
        let display = &self.display;
        Draw {
            a: shown,
            b: None,
            kind,
            operation: Operation::Single,
            first,
            step,
            channel: display.channel,
            tone: display.tone,
            exposure: display.exposure,
            offset: display.offset,
            gamma: display.gamma,
            range,
            scale,
            colormap: display.colormap,
            background: [0.0; 3],
        }
    }

    /// Returns the pixel whose values are shown: the pinned one, or else the one under the pointer.
    pub fn chosen(&self) -> Option<[u32; 2]> {
        self.pinned.or(self.hovered)
    }

    /// Returns the ends of the scale that shows most of a difference.
    fn difference_range(&mut self, a: &Layer, b: &Layer) -> Range {
        let key = ([a.shown.id, b.shown.id], self.compare);
        if let Some((ids, compare, range)) = self.difference
            && (ids, compare) == key
        {
            return range;
        }
        let pixels = a.image().extent.pixels();
        let mean = |layer: &Layer, pixel: usize| {
            layer.image().planes.iter().map(|plane| plane[pixel]).sum::<f32>() / layer.image().channels() as f32
        };
        let difference = |pixel: usize| {
            let (a, b) = (mean(a, pixel), mean(b, pixel));
            if self.compare == Compare::Relative { (a - b) / (b.abs() + display::RELATIVE_EPSILON) } else { a - b }
        };
        let step = pixels.div_ceil(1 << 16).max(1);
        let mut values: Vec<f32> =
            (0..pixels).step_by(step).map(difference).filter(|value| value.is_finite()).collect();
        let range = range_of(&mut values, Kind::Scalar(Scale::Diverging));
        self.difference = Some((key.0, key.1, range));
        range
    }
}

/// Returns [`Draw::first`] and [`Draw::step`] of an image that begins at the corner of `rect` and has this number of
/// points per pixel.
fn placed(painter: &Painter, rect: Rect, points_per_pixel: f32) -> ([f32; 2], f32) {
    let pixels_per_point = painter.pixels_per_point();
    let step = 1.0 / (points_per_pixel * pixels_per_point);
    ((rect.min.to_vec2() * -pixels_per_point * step).into(), step)
}
