//! Renders of one frame with different seeds, merged into one: means weighted by the numbers of samples, and halves.

use std::path::Path;

use stein::error::{Error, FileCause, LayerCause, Result};
use stein::frame::SamplesPerPixel;
use stein::text;

use crate::buffer_set::BufferSet;
use crate::classify::{Classified, LayerId, Meaning};
use crate::counts;
use crate::file::ExrFile;
use crate::layout::{Layout, Quantity, RoleName};
use crate::request::BufferSetRequest;
use crate::source::{Picture, Planes, SignalSource};
use crate::uses::Note;

/// Header attributes that differ between frames, cameras and views, but not between seeds.
const OF_ONE_FRAME: [&str; 6] = ["Frame", "Camera", "Scene", "frame", "camera", "view"];

/// Merges the requested seeds with the input, in place. Afterwards the set's colours, features, lights and alphas are
/// the means of all seeds, and the halves of colours and features are the means of the seeds of each half. Everything
/// else stays as the input has it. Returns remarks on layers that some seed lacks.
///
/// # Errors
/// [`Error::File`] for a seed that cannot be read, that shows another frame or that is the same render; [`Error::Layer`]
/// for a seed without the colour, or with another data window.
pub(crate) fn merge(
    set: &mut BufferSet,
    request: &BufferSetRequest,
    classified: &Classified,
    layout: &Layout,
) -> Result<Vec<Note>> {
    let mut seeds = Vec::new();
    for path in &request.seeds {
        let file = ExrFile::read(path, request.png_encoding)?;
        check_is_seed(set, &file)?;
        seeds.push(file);
    }
    let mut notes = Vec::new();
    let input = set.files[0].clone_without_samples();
    let mut halves = [input.clone_without_samples(), input];
    let of_pictures: Vec<Weights> = set
        .pictures
        .iter()
        .map(|picture| Weights::of(picture, &set.files[0], &seeds, layout, request))
        .collect::<Result<_>>()?;
    halves[1].path = seeds.get(of_pictures[0].first_of_b().saturating_sub(1)).map_or_else(
        || halves[1].path.clone(),
        |seed| seed.path.clone(),
    );
    // The halves are made of the seeds as they are, so they come before the means.
    let half_files = [set.files.len(), set.files.len() + 1];
    for (index, weights) in of_pictures.iter().enumerate() {
        let mut picture = set.pictures[index].clone();
        let name = picture.features.iter().map(|(name, _)| Some(name.clone()));
        let names: Vec<Option<String>> = std::iter::once(None).chain(name).collect();
        let sources = std::iter::once(&mut picture.color).chain(picture.features.iter_mut().map(|(_, it)| it));
        for (source, name) in sources.zip(names) {
            // The input's own halves are halves of one seed.
            let own_halves = [&source.half_a, &source.half_b].into_iter().flatten().filter(|half| half.file == 0);
            set.stale.extend(own_halves.map(|half| half.layer));
            let id = LayerId { file: source.mean.file, layer: source.mean.layer };
            if let Err(missing) = put_halves(set, &seeds, weights, source, half_files, &mut halves) {
                match name {
                    Some(_) => notes.push(Note { id, text: format!("{} lacks it: no halves", text::path(&missing)) }),
                    None => unreachable!("seeds without the colour are refused"),
                }
            }
        }
        set.pictures[index] = picture;
    }
    average(set, &seeds, classified, &of_pictures, &mut notes);
    for (picture, weights) in set.pictures.iter_mut().zip(of_pictures) {
        picture.samples = weights.total();
        picture.samples_layer = None;
    }
    set.files.extend(halves);
    set.seeds = request.seeds.clone();
    Ok(notes)
}

/// Checks that a file is another render of the frame that the input shows.
fn check_is_seed(set: &BufferSet, seed: &ExrFile) -> Result<()> {
    let input = &set.files[0];
    let not_a_seed = |reason: String| {
        let cause = FileCause::NotASeed { of: input.path.clone(), reason };
        Err(Error::File { path: seed.path.clone(), cause })
    };
    for name in OF_ONE_FRAME {
        if let (Some(own), Some(other)) = (input.text_attribute(0, name), seed.text_attribute(0, name))
            && own != other
        {
            let [own, other] = [&own, &other].map(|value| text::name(value).into_owned());
            return not_a_seed(format!("its header says {name} '{other}', and the input's '{own}'"));
        }
    }
    if input.cameras() != seed.cameras() {
        return not_a_seed("its camera is another one".into());
    }
    for picture in &set.pictures {
        let planes = &picture.color.mean;
        let layer = &input.layers[planes.layer];
        let Some(found) = same_layer(input, seed, planes) else {
            let cause = LayerCause::Missing { layers: seed.layers_like(&layer.name) };
            let name = if layer.name.is_empty() { "R G B".to_owned() } else { layer.name.clone() };
            return Err(Error::Layer { path: seed.path.clone(), layer: name, cause });
        };
        let (own, other) = (input.data_window(layer.part), seed.data_window(found.0));
        if own != other {
            let (found, expected) = (other.to_string(), own.to_string());
            let cause = LayerCause::DataWindow { found, expected, color_file: input.path.clone() };
            return Err(Error::Layer { path: seed.path.clone(), layer: layer.name.clone(), cause });
        }
        let same = input.planes(layer.part, &planes.channels) == seed.planes(found.0, &found.1);
        // Pictures without any noise are the same for all seeds.
        if same && !is_constant(input, layer.part, &planes.channels) {
            return not_a_seed("it holds the same pixels, so that nothing is known of their noise".into());
        }
    }
    Ok(())
}

fn is_constant(file: &ExrFile, part: usize, channels: &[usize]) -> bool {
    file.planes(part, channels).planes.iter().all(|plane| plane.iter().all(|value| *value == plane[0]))
}

/// Returns part and channels in another file of the layer of the same name; `None` if a channel is not there.
fn same_layer(own: &ExrFile, other: &ExrFile, planes: &Planes) -> Option<(usize, Vec<usize>)> {
    let layer = &own.layers[planes.layer];
    let found = other.layers.iter().find(|candidate| candidate.name == layer.name)?;
    let channel = |index: &usize| {
        let suffix = &layer.channels.iter().find(|channel| channel.index == *index)?.suffix;
        found.channels.iter().find(|channel| channel.suffix == *suffix).map(|channel| channel.index)
    };
    Some((found.part, planes.channels.iter().map(channel).collect::<Option<_>>()?))
}

/// Weights of the seeds in a picture: the input is the first.
struct Weights {
    /// Numbers of samples; equal numbers if some seed does not know them.
    counts: Vec<SamplesPerPixel>,
    is_known: bool,
    /// Whether each seed belongs to half A.
    in_a: Vec<bool>,
}

impl Weights {
    fn of(
        picture: &Picture,
        input: &ExrFile,
        seeds: &[ExrFile],
        layout: &Layout,
        request: &BufferSetRequest,
    ) -> Result<Self> {
        let part = input.layers[picture.color.mean.layer].part;
        let window = input.data_window(part);
        let mut known = vec![picture.samples.clone()];
        for seed in seeds {
            known.push(match (request.samples, &picture.samples_layer) {
                (Some(count), _) => SamplesPerPixel::Uniform(count as f32),
                (None, layer) => {
                    let counted = layer.as_ref().filter(|planes| planes.file == 0).and_then(|planes| {
                        let layer = seed.layers.iter().position(|it| it.name == input.layers[planes.layer].name)?;
                        let channels = vec![seed.layers[layer].channels[0].index];
                        Some(Planes { file: 0, layer, channels })
                    });
                    // Every kind of count was made of the input's channel.
                    let is_fraction = counted.is_some() && picture.counts_are_fractions;
                    let part = part.min(seed.parts() - 1);
                    let header = counts::in_header(seed, part, layout, &picture.scope.group);
                    counts::known(std::slice::from_ref(seed), window, header, counted, is_fraction).0
                }
            });
        }
        let is_known = known.iter().all(|count| *count != SamplesPerPixel::Unknown);
        if !is_known {
            known.fill(SamplesPerPixel::Uniform(1.0));
        }
        let total = |count: &SamplesPerPixel| match count {
            SamplesPerPixel::Unknown => 0.0,
            SamplesPerPixel::Uniform(count) => f64::from(*count),
            SamplesPerPixel::PerPixel(counts) => {
                let plane = &counts.planes[0];
                plane.iter().map(|count| f64::from(*count)).sum::<f64>() / plane.len() as f64
            }
        };
        // Each seed goes to the half that has fewer samples; the input is in half A.
        let mut sums = [0.0; 2];
        let in_a = known.iter().map(|count| {
            let to_a = sums[0] <= sums[1];
            sums[usize::from(!to_a)] += total(count);
            to_a
        });
        let in_a = in_a.collect();
        Ok(Self { counts: known, is_known, in_a })
    }

    /// Returns the position of the first seed in half B.
    fn first_of_b(&self) -> usize {
        self.in_a.iter().position(|in_a| !in_a).unwrap_or(0)
    }

    fn count(&self, seed: usize, pixel: usize) -> f64 {
        match &self.counts[seed] {
            SamplesPerPixel::Unknown => 0.0,
            SamplesPerPixel::Uniform(count) => f64::from(*count),
            SamplesPerPixel::PerPixel(counts) => f64::from(counts.planes[0].get(pixel).copied().unwrap_or(0.0)),
        }
    }

    /// Returns mean and half of the spread of the values of all seeds at a pixel. Where no seed has samples, all count
    /// the same.
    fn merged(&self, values: &[f32], pixel: usize) -> Merged {
        let mut counts: Vec<f64> = (0..values.len()).map(|seed| self.count(seed, pixel).max(0.0)).collect();
        if counts.iter().all(|count| *count == 0.0) {
            counts.fill(1.0);
        }
        let mut halves = [(0.0, 0.0); 2];
        let mut squares = 0.0;
        for ((value, count), in_a) in values.iter().zip(&counts).zip(&self.in_a) {
            let half = &mut halves[usize::from(!in_a)];
            *half = (half.0 + count * f64::from(*value), half.1 + count);
            squares += count * count * f64::from(*value);
        }
        let [(sum_a, count_a), (sum_b, count_b)] = halves;
        let count = count_a + count_b;
        let spread = match count_a > 0.0 && count_b > 0.0 {
            true => (sum_a / count_a - sum_b / count_b) * (count_a * count_b).sqrt() / count,
            // One half has no samples here, so that nothing is known.
            false => f64::NAN,
        };
        Merged { mean: (sum_a + sum_b) / count, spread, of_squares: squares / (count * count), sum: count }
    }

    fn total(&self) -> SamplesPerPixel {
        let uniform = self.counts.iter().map(|count| match count {
            SamplesPerPixel::Uniform(count) => Some(*count),
            _ => None,
        });
        if !self.is_known {
            return SamplesPerPixel::Unknown;
        }
        if let Some(counts) = uniform.collect::<Option<Vec<f32>>>() {
            return SamplesPerPixel::Uniform(counts.iter().sum());
        }
        let image = self.counts.iter().find_map(|count| match count {
            SamplesPerPixel::PerPixel(image) => Some(image),
            _ => None,
        });
        let Some(image) = image else { return SamplesPerPixel::Unknown };
        let mut sum = image.clone();
        for (pixel, value) in sum.planes[0].iter_mut().enumerate() {
            *value = (0..self.counts.len()).map(|seed| self.count(seed, pixel)).sum::<f64>() as f32;
        }
        SamplesPerPixel::PerPixel(sum)
    }
}

/// Values of all seeds in one.
struct Merged {
    mean: f64,
    /// `(A − B)·√(n_A·n_B)/n`: see [`stein::frame::Signal::half_spread`].
    spread: f64,
    /// Σ n_i²·x_i/n², the merged variance of means.
    of_squares: f64,
    sum: f64,
}

/// Puts the halves of a signal into the files of the halves. With unequal numbers of samples, the halves are such that
/// their mean is the merged mean, and their difference has the noise that equal halves would have.
///
/// # Errors
/// The path of a seed that lacks the layer.
fn put_halves<'a>(
    set: &BufferSet,
    seeds: &'a [ExrFile],
    weights: &Weights,
    source: &mut SignalSource,
    half_files: [usize; 2],
    halves: &mut [ExrFile; 2],
) -> std::result::Result<(), &'a Path> {
    let planes = source.mean.clone();
    let own = &set.files[planes.file];
    // Layers of other files belong to the input alone.
    if planes.file > 0 {
        return Ok(());
    }
    let part = own.layers[planes.layer].part;
    let mut places = Vec::new();
    for seed in seeds {
        let place = same_layer(own, seed, &planes).filter(|place| seed.data_window(place.0) == own.data_window(part));
        places.push(place.ok_or(seed.path.as_path())?);
    }
    for (position, &channel) in planes.channels.iter().enumerate() {
        if planes.channels[..position].contains(&channel) {
            continue;
        }
        let values = columns(own, part, channel, seeds, &places, position);
        let (mut a, mut b) = (Vec::with_capacity(values[0].len()), Vec::with_capacity(values[0].len()));
        let mut at_pixel = vec![0.0; values.len()];
        for pixel in 0..values[0].len() {
            at_pixel.iter_mut().zip(&values).for_each(|(value, plane)| *value = plane[pixel]);
            let Merged { mean, spread, .. } = weights.merged(&at_pixel, pixel);
            // An infinite value, such as the depth of a miss, has no spread.
            let spread = if mean.is_infinite() { 0.0 } else { spread };
            a.push((mean + spread) as f32);
            b.push((mean - spread) as f32);
        }
        halves[0].set_plane(part, channel, a);
        halves[1].set_plane(part, channel, b);
    }
    let half = |file: usize| Some(Planes { file, ..planes.clone() });
    (source.half_a, source.half_b) = (half(half_files[0]), half(half_files[1]));
    Ok(())
}

/// Returns a channel of the input and of all seeds.
fn columns(
    own: &ExrFile,
    part: usize,
    channel: usize,
    seeds: &[ExrFile],
    places: &[(usize, Vec<usize>)],
    position: usize,
) -> Vec<Vec<f32>> {
    let of_seeds = seeds.iter().zip(places).map(|(seed, (part, channels))| seed.plane(*part, channels[position]));
    std::iter::once(own.plane(part, channel)).chain(of_seeds).collect()
}

/// Replaces the input's layers that are means or variances of samples by those of all seeds together.
fn average(
    set: &mut BufferSet,
    seeds: &[ExrFile],
    classified: &Classified,
    weights: &[Weights],
    notes: &mut Vec<Note>,
) {
    for layer in 0..set.files[0].layers.len() {
        let is_used = set.pictures.iter().flat_map(Picture::signals).any(|signal| {
            let of_variance = signal.variance.as_ref().map(|variance| &variance.planes);
            [Some(&signal.mean), of_variance].into_iter().flatten().any(|it| (it.file, it.layer) == (0, layer))
        });
        let Some(quantity) = averaged(&set.files[0], classified, layer, is_used) else { continue };
        let own = &set.files[0];
        let part = own.layers[layer].part;
        let scope = crate::classify::Scope::of(&own.layers[layer], classified.meanings[layer].as_ref());
        let picture = set.pictures.iter().position(|picture| picture.scope == scope).unwrap_or(0);
        let channels: Vec<usize> = own.layers[layer].channels.iter().map(|channel| channel.index).collect();
        let planes = Planes { file: 0, layer, channels: channels.clone() };
        let place = |seed: &ExrFile| {
            same_layer(own, seed, &planes).filter(|place| seed.data_window(place.0) == own.data_window(part))
        };
        let Some(places) = seeds.iter().map(place).collect::<Option<Vec<_>>>() else {
            notes.push(Note { id: LayerId { file: 0, layer }, text: "some seed lacks it: of the input alone".into() });
            continue;
        };
        for (position, channel) in channels.into_iter().enumerate() {
            let values = columns(&set.files[0], part, channel, seeds, &places, position);
            let mut merged = Vec::with_capacity(values[0].len());
            let mut at_pixel = vec![0.0; values.len()];
            for pixel in 0..values[0].len() {
                at_pixel.iter_mut().zip(&values).for_each(|(value, plane)| *value = plane[pixel]);
                let all = weights[picture].merged(&at_pixel, pixel);
                merged.push(match quantity {
                    Quantity::VarianceOfMean => all.of_squares,
                    Quantity::Count => all.sum,
                    _ => all.mean,
                } as f32);
            }
            set.files[0].set_plane(part, channel, merged);
        }
    }
}

/// Returns the quantity of a layer that all seeds share; `None` for layers that stay as the input has them.
fn averaged(file: &ExrFile, classified: &Classified, layer: usize, is_used: bool) -> Option<Quantity> {
    if crate::classify::is_whole_numbers(file, layer) {
        return None;
    }
    let meaning = classified.meanings[layer].as_ref();
    let role_of = |meaning: &Meaning| match meaning.of {
        Some(of) => classified.meanings[of.layer].as_ref().and_then(|meaning| meaning.role),
        None => meaning.role,
    };
    // A colour that no rule names, or a feature that no rule names but comes with a variance.
    let Some(meaning) = meaning else { return Some(Quantity::Mean).filter(|_| is_used) };
    let is_of_samples = role_of(meaning).is_none_or(|role| {
        matches!(role, RoleName::Color | RoleName::Alpha | RoleName::Light) || role.is_feature()
    });
    match meaning.quantity {
        Quantity::Mean if is_of_samples && meaning.role != Some(RoleName::Denoised) => Some(Quantity::Mean),
        quantity if quantity.is_variance() && is_of_samples => Some(quantity),
        Quantity::Count if meaning.role == Some(RoleName::Samples) => Some(Quantity::Count),
        _ => None,
    }
}
