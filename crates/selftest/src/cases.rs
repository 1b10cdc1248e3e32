//! The cases: situations that a user's render may be in, and the bounds of a result in each.

use stein::error::RequestCause;
use stein::{Extent, Image};
use stein_exr::atomic_file::Aside;

use super::checks::{Check, Subject};
use super::picture::{Picture, Samples, Sampling, Surface, corridor, exact, image, room};

/// A situation, and what is expected in it.
pub struct Case {
    /// Name, in a user's words.
    pub name: String,
    /// Radius of the window in pixels, for the methods that have one.
    pub(super) window_radius: u32,
    /// Methods that the situation concerns.
    pub methods: Vec<Subject>,
    /// Makes the render with its noise multiplied by the argument.
    base: Make,
    pub(super) damage: Option<Damage>,
    /// Makes another frame of the shot.
    pub(super) beside: Option<Box<dyn Fn(f64) -> Picture>>,
    pub(super) expected: Expected,
    /// Whether the output must become the input as the noise vanishes.
    pub(super) has_limit: bool,
    /// Whether a second run must give the same bits.
    pub(super) is_repeated: bool,
    /// Whether several strips must give the same bits.
    pub(super) in_strips: bool,
    bounds: Vec<Bound>,
}

type Make = Box<dyn Fn(f64) -> stein::Result<Picture>>;

/// Damages a render whose noise was multiplied by the number.
type Apply = Box<dyn Fn(&mut Picture, f64)>;

/// Damage to a render, and its location.
pub(super) struct Damage {
    /// Column and row of each damaged pixel.
    pub(super) pixels: Vec<(usize, usize)>,
    /// Whether the damage changes what is fixed for the frame as a whole, and so all pixels.
    pub(super) moves_units: bool,
    apply: Apply,
}

/// Expected outcome of the render.
pub(super) enum Expected {
    Result,
    /// A refusal: the colour has no usable value.
    Refusal,
}

/// A bound other than [`usual`].
struct Bound {
    check: Check,
    /// Method of the bound; `None` for all methods.
    subject: Option<Subject>,
    bound: f64,
    /// Reason why the bound differs.
    reason: &'static str,
}

/// Returns the bound of a check if the case has no other.
fn usual(check: Check, subject: Subject) -> f64 {
    match (check, subject) {
        // These figures are counts.
        (Check::Door | Check::Finite | Check::Reach | Check::Bits, _) => 0.0,
        (Check::Energy | Check::Dark, _) => 0.05,
        (Check::Error | Check::Twin, _) => 1.0,
        // The smoothing of the selection maps gives THIRD a share beside the borders of its regions, whatever the
        // noise, and the published algorithm has no guard. So the method does not become the identity, and may even
        // correct more if there is less noise.
        (Check::Limit, Subject::DfcThesis) => 3.0,
        // A sixteenth of the noise is left.
        (Check::Limit, _) => 0.25,
    }
}

/// Reason for errors that are made of a variance from a fit of features.
const FITTED: &str = "the noise is what a fit of six numbers leaves, which float32 has four digits of";

/// Reason for images without features, which tell little of their noise: texture and edges look like noise.
const IMAGE_ALONE: &str = "texture and edges look like noise where no feature explains them";
const THIRD: &str =
    "the smoothed selection maps hand THIRD a share where it is wrong, and the published algorithm has no guard";
const DECADES: &str = "a Gaussian mixes pixels of which each is twice as bright as its neighbour";
const BLACK: &str =
    "below some 10⁻²³, ε of eq. 7.4 tells no pixels apart, so that all are averaged as if they were black";
const BORDER: &str = "where the image's border cuts patches, opposite neighbours on a gradient get unequal weights, however little noise there is";
const CHEQUER: &str = "the choice of scale is smoothed over the pixels around, which blurs a chequer of 5×4 pixels by more than the noise";
const FEW_PIXELS: &str = "averages over a few pixels differ by chance";
const NO_SCALES: &str = "scales are told apart by averages over more pixels than there are";
const CLAIM: &str = "the claim is wrong and nothing contradicts it: it is filtered as the claim asks for";
const OUTLIER: &str =
    "the energy of a spike is no part of the image, and what is not spread with it goes; `dark` holds the rest";
const SPREAD: &str =
    "halves travel as mean and half spread: beside a million, the last digits of the other half are lost";
const FLOOR: &str = "differences below a thousandth of a pixel's brightness are not told apart, so that a correction of that size stays";
const KEPT: &str = "what has no noise keeps its light, while its neighbours average over it";
const HUGE: &str = "errors of filters that differ by next to nothing beside the claim are told apart by rounding";
const MOVED: &str = "a pixel with next to no noise is moved back by the root of a quotient, whose last digits are lost";
const RENDER: &str = "its outliers hold that much of the energy, and go";

impl Case {
    fn new(name: impl Into<String>, window_radius: u32, base: impl Fn(f64) -> Picture + 'static) -> Self {
        Self {
            name: name.into(),
            window_radius,
            methods: Subject::ALL.to_vec(),
            base: Box::new(move |noise| Ok(base(noise))),
            damage: None,
            beside: None,
            expected: Expected::Result,
            has_limit: true,
            is_repeated: false,
            in_strips: false,
            bounds: Vec::new(),
        }
    }

    /// Makes the render with its noise multiplied by `noise`, and damages it.
    pub(super) fn picture(&self, noise: f64) -> stein::Result<Picture> {
        let mut picture = self.sound(noise)?;
        if let Some(damage) = &self.damage {
            (damage.apply)(&mut picture, noise);
        }
        Ok(picture)
    }

    /// Makes the render without the damage.
    pub(super) fn sound(&self, noise: f64) -> stein::Result<Picture> {
        (self.base)(noise)
    }

    pub(super) fn bound(&self, subject: Subject, check: Check) -> f64 {
        let own = self.bounds.iter().find(|bound| bound.check == check && bound.subject.is_none_or(|of| of == subject));
        own.map_or_else(|| usual(check, subject), |bound| bound.bound)
    }

    /// Formats the reasons of the bounds that are not usual, one line for each.
    pub fn reasons(&self) -> Vec<String> {
        let line = |bound: &Bound| {
            let of = bound.subject.map_or_else(String::new, |subject| format!(" of {}", subject.name()));
            format!("{}{of} up to {}: {}", bound.check.name(), bound.bound, bound.reason)
        };
        self.bounds.iter().map(line).collect()
    }

    fn damaged(self, pixels: Vec<(usize, usize)>, apply: impl Fn(&mut Picture, f64) + 'static) -> Self {
        Self { damage: Some(Damage { pixels, moves_units: false, apply: Box::new(apply) }), ..self }
    }

    /// Adds a damage that is everywhere, or that changes the units of the frame.
    fn changed(self, apply: impl Fn(&mut Picture, f64) + 'static) -> Self {
        Self { damage: Some(Damage { pixels: Vec::new(), moves_units: true, apply: Box::new(apply) }), ..self }
    }

    fn refused(self) -> Self {
        Self { expected: Expected::Refusal, ..self }
    }

    /// Prepares a case of a colour without noise knowledge, which the published algorithm does not take.
    fn image_only(self) -> Self {
        let case = Self { methods: vec![Subject::Dfc, Subject::Nlm, Subject::Gem], ..self };
        case.within(Check::Twin, 20.0, FITTED)
            .but(Subject::Nlm, Check::Limit, 2.0, IMAGE_ALONE)
            .but(Subject::Gem, Check::Limit, 2.0, IMAGE_ALONE)
            .but(Subject::Gem, Check::Error, 4.0, IMAGE_ALONE)
    }

    fn within(mut self, check: Check, bound: f64, reason: &'static str) -> Self {
        self.bounds.push(Bound { check, subject: None, bound, reason });
        self
    }

    fn but(mut self, subject: Subject, check: Check, bound: f64, reason: &'static str) -> Self {
        // The bound of one method comes before the bounds of all methods.
        self.bounds.insert(0, Bound { check, subject: Some(subject), bound, reason });
        self
    }

    fn repeated(self) -> Self {
        Self { is_repeated: true, ..self }
    }

    /// Limits the case to the methods that use features; for the others it would repeat another case.
    fn of_features(self) -> Self {
        Self { methods: vec![Subject::Dfc, Subject::DfcThesis], ..self }
    }

    fn without_limit(self) -> Self {
        Self { has_limit: false, ..self }
    }
}

const fn extent(width: u32, height: u32) -> Extent {
    Extent { width, height }
}

/// Extent of most cases.
const STANDARD: Extent = extent(24, 20);
/// Extent so wide (for [`TALL`], so high) that parts of the image are out of reach of a pixel near one end.
const WIDE: Extent = extent(128, 4);
const TALL: Extent = extent(4, 128);
const RADIUS: u32 = 3;
/// Radius of the window in wide images.
const SMALL: u32 = 2;

fn standard(noise: f64) -> Picture {
    Picture::sampled(STANDARD, Sampling::new(noise), room(STANDARD))
}

fn of(extent: Extent) -> impl Fn(f64) -> Picture {
    move |noise| Picture::sampled(extent, Sampling::new(noise), room(extent))
}

fn long(extent: Extent) -> impl Fn(f64) -> Picture {
    move |noise| Picture::sampled(extent, Sampling::new(noise), corridor(extent))
}

/// Makes a picture of one surface everywhere.
fn flat(noise: f64, surface: Surface) -> Picture {
    Picture::sampled(STANDARD, Sampling::new(noise), move |_, _| surface)
}

/// The damaged pixel of the wide image; `ROW` is the damaged row of the tall one.
const PIXEL: (usize, usize) = (2, 1);
const ROW: usize = 2;

/// Returns every case, in the order in which the cases are reported.
pub fn cases() -> Vec<Case> {
    let mut cases = Vec::new();
    cases.extend(plain().into_iter().map(Case::repeated));
    // The limit is checked in the other cases: these differ only in size, or in what is repaired before a frame is
    // made.
    cases.extend(sizes().into_iter().map(|case| case.repeated().without_limit()));
    cases.extend(broken().into_iter().map(Case::without_limit));
    cases.extend(noise_told_wrong());
    cases.extend(ranges());
    cases.extend(samples());
    cases.extend(features().into_iter().map(Case::of_features));
    cases.extend(windows().into_iter().map(Case::repeated));
    cases.extend(outliers());
    cases.extend(renders().into_iter().map(Case::repeated));
    cases
}

fn plain() -> Vec<Case> {
    vec![
        Case::new("an ordinary room", RADIUS, standard),
        Case::new("all of it is black, without noise", RADIUS, |noise| flat(noise, Surface::grey(0.0))),
        Case::new("all of it is black, and noise is claimed", RADIUS, |noise| flat(noise, Surface::grey(0.0))).changed(
            |picture, noise| {
                picture.variance().planes.iter_mut().flatten().for_each(|value| *value = (noise * noise) as f32);
            },
        ),
        Case::new("a constant image without noise", RADIUS, |_| flat(0.0, Surface::grey(0.7))),
        Case::new("a constant image with noise", RADIUS, |noise| flat(noise, Surface::grey(0.7))),
        Case::new("a room without noise", RADIUS, |_| standard(0.0)).but(
            Subject::DfcThesis,
            Check::Error,
            2500.0,
            THIRD,
        ),
        Case::new("grey: all channels are the same", RADIUS, |noise| {
            let mut picture = standard(noise);
            let channels = [
                Some(&mut picture.color.mean),
                picture.color.half_a.as_mut(),
                picture.color.half_b.as_mut(),
                picture.color.variance_of_mean.as_mut(),
            ];
            for image in channels.into_iter().flatten().chain(picture.truth.as_mut()) {
                image.planes = vec![image.planes[0].clone(); 3];
            }
            picture
        }),
        Case::new("negative values only", RADIUS, |noise| {
            let mut picture = standard(noise);
            picture.scale_radiance(-1.0);
            Picture { unit: picture.unit.abs(), ..picture }
        }),
        Case::new("noise in a chequer, every other pixel without", RADIUS, |noise| {
            let surface = room(STANDARD);
            Picture::sampled(STANDARD, Sampling::new(noise), move |x, y| {
                let surface = surface(x, y);
                if (x + y) % 2 == 0 { surface } else { Surface { deviation: [0.0; 3], ..surface } }
            })
        }),
        Case { in_strips: true, ..Case::new("little memory: worked on in strips", SMALL, long(extent(12, 340))) },
    ]
}

fn sizes() -> Vec<Case> {
    let named = |name: &str, width: u32, height: u32, radius: u32| {
        let case = Case::new(format!("{name}, {width}×{height}"), radius, of(extent(width, height)));
        case.within(Check::Energy, 0.15, FEW_PIXELS).within(Check::Dark, 0.15, FEW_PIXELS).but(
            Subject::Gem,
            Check::Error,
            1.5,
            NO_SCALES,
        )
    };
    let mut cases = vec![
        named("one pixel", 1, 1, RADIUS),
        named("one row", 37, 1, RADIUS),
        named("one column", 1, 37, RADIUS),
        named("two by two", 2, 2, RADIUS),
    ];
    // Tiles of 8 pixels, workgroups of 32 by 2, four pixels at a time.
    for (width, height) in [(7, 9), (8, 8), (9, 7), (31, 3), (32, 2), (33, 5), (16, 17)] {
        cases.push(Case::new(
            format!("at the border of a tile, {width}×{height}"),
            RADIUS,
            long(extent(width, height)),
        ));
    }
    // The window of this radius has a side of 7.
    for side in [6, 7, 8] {
        cases.push(named("at the border of a window", side, side, RADIUS));
    }
    cases.extend([named("smaller than the window and its patches", 5, 4, 10), named("the smallest window", 24, 20, 1)]);
    cases.extend([named("a window of radius 32", 14, 12, 32), named("the largest window", 10, 9, 64)]);
    cases
}

/// Makes cases with every kind of float, in one pixel, in a row and in a whole layer.
fn broken() -> Vec<Case> {
    const VALUES: [(&str, f32); 5] = [
        ("NaN", f32::NAN),
        ("+Inf", f32::INFINITY),
        ("−Inf", f32::NEG_INFINITY),
        ("a negative value", -3.0),
        ("1e30", 1e30),
    ];
    type Layer = (&'static str, fn(&mut Picture) -> &mut Image);
    const LAYERS: [Layer; 5] = [
        ("the colour", |picture| &mut picture.color.mean),
        ("half A", Picture::half_a),
        ("the variance", Picture::variance),
        ("a feature", |picture| &mut picture.feature("albedo").mean),
        ("a feature's half", |picture| {
            picture.feature("albedo").half_b.as_mut().unwrap_or_else(|| unreachable!("it has halves"))
        }),
    ];
    let mut cases = Vec::new();
    // The repair treats all values that are not finite alike, so most layers need only one of them.
    let is_new =
        |value: f32, layer: &str| value.is_nan() || value == -3.0 || ["the colour", "the variance"].contains(&layer);
    for (what, value) in VALUES {
        for (layer, image) in LAYERS.into_iter().filter(|(layer, _)| is_new(value, layer)) {
            let fill = move |picture: &mut Picture, pixels: &[(usize, usize)]| {
                let pixels: Vec<usize> = pixels.iter().map(|(x, y)| picture.pixel(*x, *y)).collect();
                image(picture)
                    .planes
                    .iter_mut()
                    .for_each(|plane| pixels.iter().for_each(|pixel| plane[*pixel] = value));
            };
            let in_pixels = |name: String, extent: Extent, pixels: Vec<(usize, usize)>| {
                let case = Case::new(name, SMALL, long(extent));
                let damaged = pixels.clone();
                let apply = move |picture: &mut Picture, _: f64| fill(picture, &damaged);
                // An albedo of −3 changes the range of the feature.
                let case = if value == -3.0 && layer == "a feature" {
                    case.changed(apply)
                } else {
                    case.damaged(pixels, apply)
                };
                if layer.contains("feature") { case.of_features() } else { case }
            };
            cases.push(in_pixels(format!("{what} in one pixel of {layer}"), WIDE, vec![PIXEL]));
            if value.is_nan() || value == -3.0 {
                cases.push(in_pixels(
                    format!("{what} in a row of {layer}"),
                    TALL,
                    (0..TALL.width as usize).map(|x| (x, ROW)).collect(),
                ));
            }
            if value.is_nan() || value == f32::INFINITY {
                let case = Case::new(format!("{what} in all of {layer}"), RADIUS, standard);
                let case =
                    case.changed(move |picture, _| image(picture).planes.iter_mut().flatten().for_each(|v| *v = value));
                cases.push(match layer {
                    "the colour" => case.refused(),
                    // Only the halves are left then.
                    "the variance" => case.but(Subject::Gem, Check::Error, 2.0, CHEQUER),
                    layer if layer.contains("feature") => case.of_features(),
                    _ => case,
                });
            }
        }
    }
    for (what, value) in VALUES.into_iter().filter(|(_, value)| *value != -3.0) {
        for (channel, name) in ["red", "green", "blue"].into_iter().enumerate() {
            let case = Case::new(format!("{what} in all of the {name} of the colour"), RADIUS, standard);
            let case = case.changed(move |picture, _| picture.color.mean.planes[channel].fill(value));
            cases.push(case.refused());
        }
    }
    let negative = Case::new("all variances are negative", RADIUS, standard);
    let negative = negative
        .changed(|picture, _| picture.variance().planes.iter_mut().flatten().for_each(|value| *value = -*value));
    // The variances become 0, and only the halves are left.
    cases.push(negative.but(Subject::Gem, Check::Error, 2.0, CHEQUER));
    cases.push(Case::new("NaN in a block wider than the window", SMALL, of(extent(40, 24))).changed(|picture, _| {
        for pixel in (6..18).flat_map(|y| (8..24).map(move |x| 40 * y + x)) {
            picture.color.mean.planes.iter_mut().for_each(|plane| plane[pixel] = f32::NAN);
        }
    }));
    cases
}

fn noise_told_wrong() -> Vec<Case> {
    let row = |y: usize| (0..TALL.width as usize).map(move |x| (x, y)).collect::<Vec<_>>();
    let variance_of = |picture: &mut Picture, pixels: &[(usize, usize)], value: f32| {
        let pixels: Vec<usize> = pixels.iter().map(|(x, y)| picture.pixel(*x, *y)).collect();
        picture.variance().planes.iter_mut().for_each(|plane| pixels.iter().for_each(|pixel| plane[*pixel] = value));
    };
    let clean_background = |picture: &mut Picture, _: f64| {
        for pixel in 0..picture.extent().pixels() / 2 {
            picture.variance().planes.iter_mut().for_each(|plane| plane[pixel] = 0.0);
        }
    };
    let mut cases = vec![
        Case::new("no variance, halves alone", RADIUS, standard)
            .changed(|picture, _| picture.color.variance_of_mean = None)
            .but(Subject::Gem, Check::Error, 2.0, CHEQUER),
        Case::new("no halves, variance alone", RADIUS, |noise| standard(noise).without_halves()),
        Case::new("neither halves nor variance", RADIUS, |noise| standard(noise).without_halves())
            .changed(|picture, _| picture.color.variance_of_mean = None)
            .image_only(),
    ];
    for (what, value) in [("no variance", 0.0), ("an enormous variance", 1e12)] {
        cases.push(
            Case::new(format!("{what} is claimed for one pixel"), SMALL, long(WIDE))
                .damaged(vec![PIXEL], move |p, _| variance_of(p, &[PIXEL], value)),
        );
        cases.push(
            Case::new(format!("{what} is claimed for a row"), SMALL, long(TALL))
                .damaged(row(ROW), move |p, _| variance_of(p, &row(ROW), value)),
        );
        let everywhere = move |picture: &mut Picture, _: f64| {
            picture.variance().planes.iter_mut().flatten().for_each(|v| *v = value);
        };
        let case = Case::new(format!("{what} is claimed for every pixel"), RADIUS, standard).changed(everywhere);
        cases.push(if value > 0.0 {
            case.but(Subject::Nlm, Check::Error, 1.5, CLAIM).but(Subject::Gem, Check::Error, 3.0, CLAIM)
        } else {
            // Only the halves are left then.
            case.but(Subject::Gem, Check::Error, 2.0, CHEQUER)
        });
        let case = Case::new(format!("{what} is claimed for every pixel, without halves"), RADIUS, |noise| {
            standard(noise).without_halves()
        })
        .changed(everywhere);
        cases.push(if value > 0.0 {
            case.without_limit().but(Subject::Nlm, Check::Error, 10.0, CLAIM).but(
                Subject::Gem,
                Check::Error,
                20.0,
                CLAIM,
            )
        } else {
            case
        });
    }
    let two_channels = Case::new("no variance is claimed in two channels", RADIUS, standard);
    let two_channels = two_channels
        .changed(|picture, _| picture.variance().planes[1..].iter_mut().flatten().for_each(|value| *value = 0.0));
    cases.push(two_channels.but(Subject::Gem, Check::Error, 2.0, CHEQUER));
    cases.push(
        Case::new("the renderer reports 0 variance for the background", RADIUS, standard)
            .changed(clean_background)
            .but(Subject::Nlm, Check::Limit, 1.5, FLOOR)
            .but(Subject::Gem, Check::Error, 2.0, CHEQUER),
    );
    let without_halves =
        Case::new("the renderer reports 0 variance for the background, without halves", RADIUS, |noise| {
            standard(noise).without_halves()
        });
    cases.push(without_halves.changed(clean_background).but(Subject::Gem, Check::Error, 2.0, CHEQUER));
    let huge = |picture: &mut Picture, noise: f64| {
        picture.variance().planes.iter_mut().flatten().for_each(|value| *value = (noise * noise) as f32);
    };
    // The figures are in squares of the distance that cannot be told apart. They stand for a relative MSE of .015 for
    // DFC, and of .4 and .5 for the others. Identical halves are not believed.
    let clean = [
        Case::new("a clean colour with a huge variance", RADIUS, |_| standard(0.0)),
        Case::new("a clean colour with a huge variance, without halves", RADIUS, |_| standard(0.0).without_halves()),
    ];
    cases.extend(clean.into_iter().map(|case| {
        let case = case
            .changed(huge)
            .but(Subject::Dfc, Check::Error, 3e5, CLAIM)
            .but(Subject::Dfc, Check::Twin, 100.0, HUGE)
            .but(Subject::DfcThesis, Check::Error, 4e4, CLAIM);
        case.but(Subject::Nlm, Check::Error, 1e6, CLAIM).but(Subject::Gem, Check::Error, 1.3e6, CLAIM)
    }));
    cases.push(Case::new("identical halves, with variance", RADIUS, standard).changed(|picture, _| {
        let mean = picture.color.mean.clone();
        (*picture.half_a(), *picture.half_b()) = (mean.clone(), mean);
    }));
    cases.push(
        Case::new("identical halves, without variance", RADIUS, standard)
            .changed(|picture, _| {
                let mean = picture.color.mean.clone();
                (*picture.half_a(), *picture.half_b()) = (mean.clone(), mean);
                picture.color.variance_of_mean = None;
            })
            .image_only(),
    );
    cases.push(
        Case::new("half B is empty", RADIUS, standard)
            .changed(|picture, _| {
                picture.color.mean = picture.half_a().clone();
                picture.half_b().planes.iter_mut().flatten().for_each(|value| *value = 0.0);
            })
            .but(Subject::Nlm, Check::Limit, 2.0, FLOOR),
    );
    cases.push(
        Case::new("half B is empty, and there is no variance", RADIUS, standard)
            .changed(|picture, _| {
                picture.color.mean = picture.half_a().clone();
                picture.half_b().planes.iter_mut().flatten().for_each(|value| *value = 0.0);
                picture.color.variance_of_mean = None;
            })
            .image_only(),
    );
    cases.push(
        Case::new("half A is empty, and there is no variance", RADIUS, standard)
            .changed(|picture, _| {
                picture.color.mean = picture.half_b().clone();
                picture.half_a().planes.iter_mut().flatten().for_each(|value| *value = 0.0);
                picture.color.variance_of_mean = None;
            })
            .image_only(),
    );
    // The only source of noise knowledge holds none.
    for (what, value) in [("NaN", f32::NAN), ("infinity", f32::INFINITY)] {
        let fill = move |image: &mut Image| image.planes.iter_mut().flatten().for_each(|v| *v = value);
        let variance = Case::new(format!("{what} in all of the variance, without halves"), RADIUS, |noise| {
            standard(noise).without_halves()
        });
        cases.push(variance.changed(move |picture, _| fill(picture.variance())).image_only());
        let half = Case::new(format!("{what} in all of a half, without variance"), RADIUS, standard).changed(
            move |picture, _| {
                fill(picture.half_a());
                picture.color.variance_of_mean = None;
            },
        );
        cases.push(half.image_only());
    }
    cases.push(Case::new("low-discrepancy samples: the variance is four times too large", RADIUS, standard).changed(
        |picture, _| {
            picture.variance().planes.iter_mut().flatten().for_each(|value| *value *= 4.0);
        },
    ));
    cases
}

fn ranges() -> Vec<Case> {
    let decades = |x: usize| 10f64.powf(-8.0 + 16.0 * x as f64 / 47.0);
    let scaled = |factor: f32| {
        move |noise: f64| {
            let mut picture = standard(noise);
            picture.scale_radiance(factor);
            picture
        }
    };
    vec![
        Case::new("radiance from 1e-8 to 1e8 in one image", RADIUS, move |noise| {
            Picture::sampled(extent(48, 10), Sampling::new(noise), move |x, _| Surface::grey(decades(x)))
        })
        .but(Subject::Gem, Check::Energy, 0.2, DECADES)
        .but(Subject::Gem, Check::Dark, 0.2, DECADES)
        .but(Subject::Gem, Check::Error, 2.0, DECADES),
        Case::new("a bright part without noise beside a dark noisy one, 1e6 to 1", RADIUS, |noise| {
            let surface = room(STANDARD);
            Picture::sampled(STANDARD, Sampling::new(noise), move |x, y| {
                let own = surface(x, y);
                let bright = Surface { deviation: [0.0; 3], radiance: own.radiance.map(|value| 1e6 * value), ..own };
                if x < 12 { bright } else { own }
            })
        })
        .but(Subject::DfcThesis, Check::Error, 3e10, THIRD)
        .but(Subject::Gem, Check::Error, 2.0, CHEQUER),
        Case::new("texture without noise, but for one pixel", RADIUS, |noise| {
            let surface = room(STANDARD);
            Picture::sampled(STANDARD, Sampling::new(noise), move |x, y| {
                let own = surface(x, y);
                if (x, y) == (13, 9) { own } else { Surface { deviation: [0.0; 3], ..own } }
            })
        })
        .but(Subject::DfcThesis, Check::Error, 20.0, THIRD),
        Case::new("all radiance of the order of 1e-8", RADIUS, scaled(1e-8)),
        Case::new("all radiance of the order of 1e8", RADIUS, scaled(1e8)),
        Case::new("denormal radiance", RADIUS, scaled(1e-40)).without_limit().within(Check::Error, 20.0, BLACK),
        Case::new("squares of radiance are denormal", RADIUS, scaled(1e-20)),
        Case::new("radiance at the end of what is taken for finite", RADIUS, scaled(1e17)),
        Case::new("radiance at the limits of half floats", RADIUS, |noise| {
            Picture::sampled(STANDARD, Sampling::new(noise), |x, y| {
                Surface::grey(if (x / 6 + y / 5) % 2 == 0 { 65504.0 } else { 6e-8 })
            })
        })
        .but(Subject::DfcThesis, Check::Error, 3e8, THIRD),
        Case::new("written as half floats", RADIUS, |noise| {
            let mut picture = standard(noise);
            let half = |value: &mut f32| {
                // A half float has ten bits after the first, and none below 2⁻²⁴.
                let unit = (value.abs().max(6.2e-5).log2().floor() - 10.0).exp2();
                *value = (*value / unit).round() * unit;
            };
            let images = [
                Some(&mut picture.color.mean),
                picture.color.half_a.as_mut(),
                picture.color.half_b.as_mut(),
                picture.color.variance_of_mean.as_mut(),
            ];
            images.into_iter().flatten().flat_map(|image| &mut image.planes).flatten().for_each(half);
            picture
        }),
        Case::new("black beside light: u = 0 under the step of SURE", RADIUS, |noise| {
            Picture::sampled(STANDARD, Sampling::new(noise), |x, _| {
                if x < 12 { Surface { deviation: [0.3; 3], ..Surface::grey(0.0) } } else { Surface::grey(1.4) }
            })
        })
        .changed(|picture, _| {
            for pixel in (0..480).filter(|pixel| pixel % 24 < 12 && pixel % 3 == 0) {
                picture.color.mean.planes.iter_mut().for_each(|plane| plane[pixel] = 0.0);
            }
        }),
        Case::new("light and its negative: u < 0 under the step of SURE", RADIUS, |noise| {
            Picture::sampled(STANDARD, Sampling::new(noise), |x, _| Surface::grey(if x < 12 { -1.4 } else { 1.4 }))
        }),
        Case::new("dark areas where differences come near ε", RADIUS, |noise| {
            Picture::sampled(STANDARD, Sampling::new(noise), |x, y| {
                Surface::grey(if x < 12 { 1.4 } else { 1e-5 * (1.0 + (y % 3) as f64) })
            })
        }),
        Case::new("a stiff ramp: exponents of weights from 0 to 10⁶", RADIUS, |noise| {
            Picture::sampled(STANDARD, Sampling::new(noise), |x, _| {
                // Steps grow by a half each: from one deviation to a thousand in the end.
                let level = 1.0 + 1e-3 * 1.5f64.powi(x as i32);
                Surface { deviation: [2e-3; 3], ..Surface::grey(level) }
            })
        })
        .but(Subject::Gem, Check::Twin, 3.0, MOVED),
        Case::new("a gradient that runs into the border of the image", RADIUS, |noise| {
            Picture::sampled(STANDARD, Sampling::new(noise), |x, y| {
                Surface::grey(1.2 + 0.02 * x as f64 + 0.01 * y as f64)
            })
        })
        .but(Subject::Nlm, Check::Limit, 1.1, BORDER),
        Case::new("halves of 1e17 that cancel, in some pixels", RADIUS, standard)
            .changed(|picture, noise| {
                for pixel in (0..480).filter(|pixel| pixel % 97 == 5) {
                    for channel in 0..3 {
                        picture.half_a().planes[channel][pixel] = 1e17 * noise as f32;
                        picture.half_b().planes[channel][pixel] = -1e17 * noise as f32;
                    }
                }
            })
            .without_limit()
            .but(Subject::Dfc, Check::Error, 3.0, CLAIM)
            .but(Subject::DfcThesis, Check::Error, 6.0, CLAIM)
            .but(Subject::Gem, Check::Error, 16.0, CLAIM)
            .but(Subject::Nlm, Check::Twin, 20.0, SPREAD),
        Case::new("black and white by turns", RADIUS, |noise| {
            Picture::sampled(STANDARD, Sampling::new(noise), |x, y| Surface {
                deviation: [0.2; 3],
                ..Surface::grey(if (x + y) % 2 == 0 { 1.4 } else { 0.0 })
            })
        }),
    ]
}

fn samples() -> Vec<Case> {
    let drawn = |samples: usize| {
        move |noise: f64| Picture::sampled(STANDARD, Sampling { samples, ..Sampling::new(noise) }, room(STANDARD))
    };
    vec![
        Case::new("one sample per pixel, which has no variance and no second half", RADIUS, drawn(1)),
        Case::new("two samples per pixel", RADIUS, drawn(2)).but(Subject::Nlm, Check::Limit, 1.0, FLOOR),
        Case::new("four samples per pixel", RADIUS, drawn(4)).but(Subject::Gem, Check::Error, 2.0, CHEQUER),
        Case::new("sample counts that differ a thousandfold between neighbours", RADIUS, |noise| {
            let counts = |pixel: usize| if (pixel % 24 + pixel / 24).is_multiple_of(2) { 4 } else { 4096 };
            let surface = room(STANDARD);
            let mut picture =
                Picture::sampled(STANDARD, Sampling { samples: 4, ..Sampling::new(noise) }, move |x, y| {
                    let surface = surface(x, y);
                    let calmer = (4.0 / f64::from(counts(24 * y + x))).sqrt();
                    Surface { deviation: surface.deviation.map(|deviation| calmer * deviation), ..surface }
                });
            picture.samples = Samples::PerPixel((0..480).map(|pixel| counts(pixel) as f32).collect());
            picture
        }),
        Case::new("sample counts of 0, NaN and below 0 in some pixels", RADIUS, |noise| {
            let mut picture = standard(noise);
            let count = |pixel: usize| [8.0, 8.0, 0.0, f32::NAN, 8.0, -3.0, f32::INFINITY][pixel % 7];
            picture.samples = Samples::PerPixel((0..480).map(count).collect());
            picture
        }),
        Case::new("nobody knows the sample counts", RADIUS, |noise| Picture {
            samples: Samples::Unknown,
            ..standard(noise)
        }),
    ]
}

fn features() -> Vec<Case> {
    let without_noise = |mean: Image| exact(mean);
    let plane =
        |value: &dyn Fn(usize) -> f64| image(STANDARD, &(0..480).map(|pixel| [value(pixel)]).collect::<Vec<_>>());
    vec![
        Case::new("no features", RADIUS, |noise| standard(noise).without_features()),
        Case::new("eight features", RADIUS, move |noise| {
            let mut picture = standard(noise).with_normals(room(STANDARD));
            for index in 0..5usize {
                let mean = plane(&|pixel| ((pixel % 24) / (index + 2) + pixel / 24 / (index + 3)) as f64 % 3.0);
                picture.features.push((format!("{}.position", ["a", "b", "c", "d", "e"][index]), without_noise(mean)));
            }
            picture
        }),
        Case::new("nine features", RADIUS, |noise| {
            let mut picture = standard(noise);
            let depth = picture.feature("depth").clone();
            picture.features.extend((0..7).map(|index| (format!("{index}.depth"), depth.clone())));
            picture
        }),
        Case::new("infinite depth where nothing is hit", RADIUS, standard).changed(|picture, _| {
            let depth = picture.feature("depth");
            depth.mean.planes[0][..150].fill(f32::INFINITY);
            for half in [&mut depth.half_a, &mut depth.half_b].into_iter().flatten() {
                half.planes[0][..150].fill(f32::INFINITY);
            }
        }),
        Case::new("a pixel of a feature at 1000", RADIUS, standard).changed(|picture, _| {
            let albedo = picture.feature("albedo");
            let images = [Some(&mut albedo.mean), albedo.half_a.as_mut(), albedo.half_b.as_mut()];
            images.into_iter().flatten().for_each(|image| image.planes.iter_mut().for_each(|plane| plane[77] = 1000.0));
        }),
        Case::new("a sky dome far behind the scene", RADIUS, standard).changed(|picture, _| {
            let depth = picture.feature("depth");
            let images = [Some(&mut depth.mean), depth.half_a.as_mut(), depth.half_b.as_mut()];
            images.into_iter().flatten().for_each(|image| image.planes[0][..96].fill(1e4));
        }),
        Case::new("normals stored as (n + 1)/2", RADIUS, |noise| standard(noise).with_normals(room(STANDARD))).changed(
            |picture, _| {
                picture
                    .feature("normal")
                    .mean
                    .planes
                    .iter_mut()
                    .flatten()
                    .for_each(|value| *value = (*value + 1.0) / 2.0);
            },
        ),
        Case::new("depth from 1e-3 to 1e9", RADIUS, standard).changed(|picture, _| {
            for (pixel, value) in picture.feature("depth").mean.planes[0].iter_mut().enumerate() {
                *value = 10f64.powf(-3.0 + 12.0 * (pixel / 24) as f64 / 19.5) as f32;
            }
        }),
        Case::new("normals that are not normalised", RADIUS, |noise| standard(noise).with_normals(room(STANDARD)))
            .changed(|picture, _| {
                for (pixel, value) in
                    picture.feature("normal").mean.planes.iter_mut().flat_map(|plane| plane.iter_mut().enumerate())
                {
                    *value *= 1.0 + 9.0 * (pixel % 24) as f32;
                }
            }),
        Case::new("features that are the same everywhere", RADIUS, standard).changed(|picture, _| {
            for (_, feature) in &mut picture.features {
                *feature = exact(Image::filled(feature.mean.extent, feature.mean.channels(), 0.5));
            }
        }),
        Case::new("a feature that is nothing but noise", RADIUS, standard).changed(|picture, _| {
            let mut random = stein_reference::random::Random(5);
            let feature = picture.feature("albedo");
            let images = [Some(&mut feature.mean), feature.half_a.as_mut(), feature.half_b.as_mut()];
            images
                .into_iter()
                .flatten()
                .flat_map(|image| &mut image.planes)
                .flatten()
                .for_each(|value| *value = random.uniform() as f32);
            feature.variance_of_mean = Some(Image::filled(feature.mean.extent, 3, 1.0 / 12.0));
        }),
        Case::new("a feature that is nothing but noise, and does not say so", RADIUS, standard).changed(
            |picture, _| {
                let mut random = stein_reference::random::Random(6);
                let mut mean = picture.feature("albedo").mean.clone();
                mean.planes.iter_mut().flatten().for_each(|value| *value = random.uniform() as f32);
                *picture.feature("albedo") = exact(mean);
            },
        ),
        Case::new("a feature that contradicts the colour", RADIUS, move |noise| {
            let mut picture = standard(noise);
            picture.features = vec![(
                "albedo".into(),
                without_noise(plane(&|pixel| f64::from(u8::from((pixel % 24 + 2 * (pixel / 24)) % 7 < 3)))),
            )];
            picture
        }),
        Case::new("a feature of a tiny range far from 0", RADIUS, move |noise| {
            let mut picture = standard(noise);
            picture.features.push(("position".into(), without_noise(plane(&|pixel| 1e4 + 1e-1 * (pixel % 24) as f64))));
            picture
        }),
        Case::new("features without variance, halves alone", RADIUS, standard)
            .changed(|picture, _| picture.features.iter_mut().for_each(|(_, feature)| feature.variance_of_mean = None)),
        Case::new("features without halves, variance alone", RADIUS, standard).changed(|picture, _| {
            picture.features.iter_mut().for_each(|(_, feature)| (feature.half_a, feature.half_b) = (None, None));
        }),
        Case::new("features with an enormous variance", RADIUS, standard).changed(|picture, _| {
            picture.features.iter_mut().for_each(|(_, feature)| {
                feature.variance_of_mean = Some(Image::filled(feature.mean.extent, feature.mean.channels(), 1e12));
            });
        }),
    ]
}

fn windows() -> Vec<Case> {
    let with_windows = vec![Subject::Dfc, Subject::DfcThesis, Subject::Nlm];
    let other = |noise: f64| Picture::sampled(STANDARD, Sampling { seed: 8, ..Sampling::new(noise) }, room(STANDARD));
    let beside = |name: &str, beside: Box<dyn Fn(f64) -> Picture>| Case {
        methods: with_windows.clone(),
        beside: Some(beside),
        ..Case::new(name, RADIUS, standard).without_limit()
    };
    vec![
        beside("two frames of a shot that stands still", Box::new(other)),
        beside("the frame beside is black", Box::new(|noise| flat(noise, Surface::grey(0.0)))),
        beside(
            "the frame beside is a million times brighter",
            Box::new(move |noise| {
                let mut picture = other(noise);
                picture.scale_radiance(1e6);
                picture
            }),
        ),
        beside("the frame beside lacks the features", Box::new(move |noise| other(noise).without_features())),
    ]
}

fn outliers() -> Vec<Case> {
    const MILLION: f32 = 1e6;
    let spikes = |name: &str, every: &'static [(usize, usize)], told: bool, in_one_half: bool| {
        Case::new(name, SMALL, long(WIDE))
            .damaged(every.to_vec(), move |picture, noise| {
                let value = noise as f32 * MILLION;
                for (x, y) in every {
                    let pixel = picture.pixel(*x, *y);
                    if in_one_half {
                        picture.add_to_half_a(pixel, [2.0 * value; 3]);
                    } else {
                        picture.add_to_both(pixel, [value; 3]);
                    }
                    if told {
                        picture.variance().planes.iter_mut().for_each(|plane| plane[pixel] = value * value);
                    }
                }
            })
            .within(Check::Energy, 1.0, OUTLIER)
            .but(Subject::Nlm, Check::Twin, 20.0, SPREAD)
    };
    const BOTH: &str = "nothing tells that it is none: it stays, and some of it goes to its neighbours";
    vec![
        spikes("a spike of a million times the mean", &[(2, 1)], true, true),
        spikes("a spike of a million times the mean that claims a small variance", &[(2, 1)], false, true),
        spikes("a spike in both halves that claims a small variance", &[(2, 1)], false, false).within(
            Check::Error,
            1.1,
            BOTH,
        ),
        spikes("spikes of a million times the mean, clustered", &[(2, 1), (3, 1), (2, 2), (3, 2), (4, 1)], true, true),
        spikes(
            "spikes, clustered, that claim a small variance",
            &[(2, 1), (3, 1), (2, 2), (3, 2), (4, 1)],
            false,
            true,
        ),
        Case::new("fireflies beside a shadow a thousand times darker", RADIUS, |noise| {
            Picture::sampled(STANDARD, Sampling::new(noise), |x, _| Surface::grey(if x < 12 { 1.4e3 } else { 1.4 }))
                .without_features()
        })
        .changed(|picture, noise| {
            for (x, y) in [(9, 5), (7, 14)] {
                let pixel = picture.pixel(x, y);
                picture.add_to_half_a(pixel, [2e4 * noise as f32; 3]);
            }
        })
        .but(Subject::DfcThesis, Check::Error, 3e4, "spikes stay, and are smeared over the shadow")
        .within(Check::Energy, 1.0, OUTLIER),
        Case::new("one bright pixel in each corner", RADIUS, standard)
            .changed(|picture, noise| {
                for (x, y) in [(0, 0), (23, 0), (0, 19), (23, 19)] {
                    let pixel = picture.pixel(x, y);
                    picture.add_to_half_a(pixel, [200.0 * noise as f32; 3]);
                    picture
                        .variance()
                        .planes
                        .iter_mut()
                        .for_each(|plane| plane[pixel] = (100.0 * noise).powi(2) as f32);
                }
            })
            .within(Check::Energy, 1.0, OUTLIER),
        Case::new("a lamp beside a wall that shares all its features", RADIUS, |noise| {
            Picture::sampled(STANDARD, Sampling::new(noise), |x, y| {
                let is_lamp = (8..13).contains(&x) && (6..10).contains(&y);
                // A lamp that is seen directly has no noise.
                if is_lamp { Surface { deviation: [0.0; 3], ..Surface::grey(400.0) } } else { Surface::grey(1.4) }
            })
        })
        .but(Subject::DfcThesis, Check::Energy, 0.12, THIRD)
        .but(Subject::DfcThesis, Check::Error, 300.0, THIRD),
        Case::new("a clean pixel beside bright noise", RADIUS, |noise| {
            Picture::sampled(STANDARD, Sampling::new(noise), |x, y| match (x < 12, (x + y) % 5 == 0) {
                (true, _) => Surface::grey(0.07),
                (false, true) => Surface { deviation: [0.0; 3], ..Surface::grey(0.07) },
                (false, false) => Surface::grey(12.0),
            })
        })
        .but(Subject::DfcThesis, Check::Error, 60.0, THIRD)
        .but(Subject::Gem, Check::Energy, 0.25, KEPT)
        .but(Subject::Gem, Check::Dark, 0.25, KEPT)
        .but(
            Subject::Gem,
            Check::Error,
            2e4,
            "a pixel that is unlike all around it is an outlier of the choice of scales (6.2.4)",
        ),
    ]
}

fn renders() -> Vec<Case> {
    let render = |name: &str, file: &'static [u8]| {
        let mut case = Case::new(name, RADIUS, standard).without_limit();
        case.base = Box::new(move |_| {
            // The render gets a folder of its own: it is read again beside the file of the frame.
            let folder = Aside::make(tempfile::tempdir).map_err(|error| {
                stein::Error::Request(RequestCause::Other {
                    problem: format!("no folder for temporary files: {error}"),
                    remedy: "let TMPDIR name a folder that may be written to".into(),
                })
            })?;
            Picture::rendered(file, folder.path())
        });
        case
    };
    vec![
        render("a render: the lamp of a Cornell box, 8 samples per pixel", include_bytes!("crops/lamp.exr")).but(
            Subject::DfcThesis,
            Check::Error,
            800.0,
            THIRD,
        ),
        render("a render: caustics and spikes, 32 samples per pixel", include_bytes!("crops/caustic.exr"))
            .within(Check::Energy, 0.25, RENDER)
            .within(Check::Dark, 0.15, RENDER),
        render("a render: texture out of focus, 32 samples per pixel", include_bytes!("crops/focus.exr")),
    ]
}
