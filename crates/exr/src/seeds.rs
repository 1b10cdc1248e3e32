//! Renders of one frame with different seeds, merged into one: means weighted by the numbers of samples, and halves.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use stein::error::{Error, FileCause, LayerCause, RequestCause, Result};
use stein::frame::{PayloadKind, SamplesPerPixel, variance_from_image};
use stein::image::{Extent, Image, Window};
use stein::text;

use crate::buffer_set::BufferSet;
use crate::classify::{Classified, LayerId, Meaning, Rules, Scope, classify, is_whole_numbers};
use crate::counts;
use crate::file::ExrFile;
use crate::layout::{Layout, Quantity, RoleName, Rule};
use crate::multiplier::{Multiplier, MultiplierKind};
use crate::request::BufferSetRequest;
use crate::siblings;
use crate::source::{self, PayloadSource, Picture, Planes, VarianceSource};

/// Header attributes that differ between frames and cameras, but not between seeds.
const OF_ONE_FRAME: [&str; 5] = ["Frame", "Camera", "Scene", "frame", "camera"];

/// How the set was read.
pub(crate) struct Reading<'a> {
    pub(crate) layout: &'a Layout,
    pub(crate) rules: &'a Rules,
    /// Meanings of the layers in the set's files.
    pub(crate) classified: &'a [Classified],
    /// Positions of the files that belong to the input.
    pub(crate) own_files: &'a [usize],
    /// Other seeds that the layout names.
    pub(crate) seeds: &'a [PathBuf],
}

/// Merges renders with other seeds with the input, in place: those of the request, and those that the layout names.
/// Afterwards the set's colours, features, lights, factors and alphas are the means of all seeds, and the halves of
/// colours and features are the means of the seeds of each half. Layers with multipliers are multiplied by those of
/// their seed before. Everything else stays as the input has it.
///
/// # Errors
/// [`Error::File`] for a requested seed that cannot be read, that shows another frame or that is the same render;
/// [`Error::Layer`] for one without the colour, or with another data window; [`Error::Request`] for halves that are
/// given beside seeds. A seed that the layout names is left out instead.
pub(crate) fn merge(set: &mut BufferSet, request: &BufferSetRequest, reading: &Reading<'_>) -> Result<()> {
    let given = [request.half_a.is_some(), request.half_b.is_some()];
    let of_features = [&request.feature_half_a, &request.feature_half_b];
    if given.contains(&true) || of_features.iter().any(|halves| !halves.is_empty()) {
        return Err(Error::Request(RequestCause::Other {
            problem: "halves are given beside other seeds".into(),
            remedy: "give either: the seeds are the halves".into(),
        }));
    }
    let mut seeds: Vec<Seed> = Vec::new();
    let requested = request.seeds.iter().map(|path| (path, true));
    for (path, is_requested) in requested.chain(reading.seeds.iter().map(|path| (path, false))) {
        match Seed::read(set, &seeds, path, request, reading) {
            Ok(seed) => seeds.push(seed),
            Err(error) if is_requested => return Err(error),
            Err(error) => set.notes.push(format!("not used: {error}")),
        }
    }
    if seeds.is_empty() {
        return Ok(());
    }
    set.seeds = seeds.iter().map(|seed| seed.main().path.clone()).collect();
    set.seed_files = seeds.iter().flat_map(|seed| seed.files.values().skip(1)).map(|file| file.path.clone()).collect();
    set.notes.extend(seeds.iter().flat_map(|seed| seed.notes.clone()));
    let mut merger = Merger::new(&seeds, request, reading);
    merger.find_multiplied(set);
    merger.halves(set);
    merger.average(set);
    merger.finish(set);
    Ok(())
}

/// A render with another seed.
struct Seed {
    /// The counterparts of the set's own files, by the positions of these.
    files: BTreeMap<usize, ExrFile>,
    classified: Classified,
    /// Remarks on files beside it that cannot be used.
    notes: Vec<String>,
}

impl Seed {
    fn read(
        set: &BufferSet,
        others: &[Self],
        path: &Path,
        request: &BufferSetRequest,
        reading: &Reading<'_>,
    ) -> Result<Self> {
        let main = ExrFile::read(path, request.png_encoding)?;
        let mut notes = check_is_seed(set, others, &main)?;
        let classified = classify(reading.rules, &main, 0, None);
        let mut files = BTreeMap::from([(0, main)]);
        if !request.no_siblings {
            let find =
                |input: &Path| siblings::find(&reading.rules.list, input, reading.layout.stem_of(input).as_deref());
            let (own, found) = (find(set.input()), find(path));
            // A file is known by its rule and by the rule of the file that it describes.
            let place = |of: Option<&PathBuf>, all: &[siblings::Sibling]| {
                of.and_then(|of| all.iter().find(|it| it.path == *of)).map(|it| it.rule)
            };
            for sibling in &own {
                let is_counterpart = |it: &&siblings::Sibling| {
                    it.rule == sibling.rule && place(it.of.as_ref(), &found) == place(sibling.of.as_ref(), &own)
                };
                let index = set.files.iter().position(|file| file.path == sibling.path);
                let counterpart = found.iter().find(is_counterpart).filter(|it| it.path != sibling.path);
                let (Some(index), Some(counterpart)) = (index, counterpart) else { continue };
                if files.contains_key(&index) {
                    continue;
                }
                match beside_seed(set, index, &counterpart.path, request) {
                    Ok(file) => drop(files.insert(index, file)),
                    Err(error) => notes.push(format!("not used: {error}")),
                }
            }
        }
        Ok(Self { files, classified, notes })
    }

    fn main(&self) -> &ExrFile {
        &self.files[&0]
    }
}

/// Reads the counterpart of a file beside the input, which shows the same frame in the same resolution.
fn beside_seed(set: &BufferSet, index: usize, path: &Path, request: &BufferSetRequest) -> Result<ExrFile> {
    let file = ExrFile::read(path, request.png_encoding)?;
    if let Some(reason) = other_frame(&set.files[0], &file) {
        let cause = FileCause::OtherFrame { of: set.input().to_owned(), reason };
        return Err(Error::File { path: path.to_owned(), cause });
    }
    let own = &set.files[index];
    match source::other_resolution(own, own.data_window(0), &file, 0) {
        Some(cause) => Err(Error::Layer { path: path.to_owned(), layer: file.layers[0].title(), cause }),
        None => Ok(file),
    }
}

/// Checks that a file is another render of the frame that the input shows. Returns remarks on values that do not count.
fn check_is_seed(set: &BufferSet, others: &[Seed], seed: &ExrFile) -> Result<Vec<String>> {
    let input = &set.files[0];
    let not_a_seed = |reason: String| {
        let cause = FileCause::NotASeed { of: input.path.clone(), reason };
        Err(Error::File { path: seed.path.clone(), cause })
    };
    if let Some(difference) = other_frame(input, seed) {
        return not_a_seed(difference);
    }
    let mut notes = Vec::new();
    for picture in &set.pictures {
        let planes = &picture.color.mean;
        let layer = &input.layers[planes.layer];
        if let Some(cause) = source::other_resolution(input, input.data_window(layer.part), seed, 0) {
            return Err(Error::Layer { path: seed.path.clone(), layer: layer.title(), cause });
        }
        let Some(found) = source::same_layer(input, seed, planes) else {
            let cause = LayerCause::Missing { layers: seed.layers_like(&layer.name) };
            return Err(Error::Layer { path: seed.path.clone(), layer: layer.title(), cause });
        };
        let (own, other) = (input.data_window(layer.part), seed.data_window(found.0));
        if own != other {
            let (found, expected) = (other.to_string(), own.to_string());
            let cause = LayerCause::DataWindow { found, expected, color_file: input.path.clone() };
            return Err(Error::Layer { path: seed.path.clone(), layer: layer.title(), cause });
        }
        let color = seed.planes(found.0, &found.1);
        let damaged = color.planes.iter().flatten().filter(|value| !value.is_finite()).count();
        if damaged == color.planes.iter().map(Vec::len).sum::<usize>() {
            return not_a_seed("not one of its pixels has a usable value".into());
        }
        if damaged > 0 {
            let path = text::path(&seed.path);
            notes.push(format!("{path}: {damaged} values of the colour are not finite and do not count"));
        }
        // Pictures without any noise are the same for all seeds.
        if color.planes.iter().all(|plane| plane.iter().all(|value| *value == plane[0])) {
            continue;
        }
        let is_same = |file: &ExrFile| {
            source::same_layer(input, file, planes)
                .is_some_and(|(part, channels)| file.planes(part, &channels) == color)
        };
        if let Some(same) = std::iter::once(input).chain(others.iter().map(Seed::main)).find(|file| is_same(file)) {
            let same = text::path(&same.path);
            return not_a_seed(format!("it holds the same pixels as {same}, so that nothing is known of their noise"));
        }
    }
    Ok(notes)
}

/// Returns the difference between two files that cannot show the same frame.
pub(crate) fn other_frame(own: &ExrFile, other: &ExrFile) -> Option<String> {
    let (of_own, of_other) = (own.attributes(), other.attributes());
    for name in OF_ONE_FRAME {
        let value = |attributes: &[(String, String)]| {
            attributes.iter().find(|(found, _)| found == name).map(|(_, value)| text::name(value).into_owned())
        };
        if let (Some(own), Some(other)) = (value(&of_own), value(&of_other))
            && own != other
        {
            return Some(format!("its header says {name} '{other}', and the input's '{own}'"));
        }
    }
    if let (Some(own), Some(other)) = (own.view(), other.view())
        && own != other
    {
        return Some(format!("it shows the view '{}', and the input '{}'", text::name(&other), text::name(&own)));
    }
    (own.cameras() != other.cameras()).then(|| "its camera is another one".into())
}

/// Weights of the seeds in a picture; the input is the first seed.
#[derive(Clone)]
struct Weights {
    scope: Scope,
    /// The pixels that have counts.
    window: Window,
    /// Numbers of samples; equal numbers if some seed does not know them.
    counts: Vec<SamplesPerPixel>,
    is_known: bool,
    /// Whether each seed belongs to half A.
    in_a: Vec<bool>,
}

impl Weights {
    fn new(scope: Scope, window: Window, mut counts: Vec<SamplesPerPixel>) -> Self {
        let is_known = counts.iter().all(|count| *count != SamplesPerPixel::Unknown);
        if !is_known {
            counts.fill(SamplesPerPixel::Uniform(1.0));
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
        let in_a = counts.iter().map(|count| {
            let to_a = sums[0] <= sums[1];
            sums[usize::from(!to_a)] += total(count);
            to_a
        });
        let in_a = in_a.collect();
        Self { scope, window, counts, is_known, in_a }
    }

    /// Returns the weights of the pixels of a layer, which may be cropped.
    fn in_window(&self, window: Window) -> Cow<'_, Self> {
        if window == self.window {
            return Cow::Borrowed(self);
        }
        let aligned = |count: &SamplesPerPixel| match count {
            SamplesPerPixel::PerPixel(image) => {
                SamplesPerPixel::PerPixel(source::aligned(image.clone(), self.window, window, 0.0))
            }
            other => other.clone(),
        };
        Cow::Owned(Self { counts: self.counts.iter().map(aligned).collect(), window, ..self.clone() })
    }

    fn count(&self, seed: usize, pixel: usize) -> f64 {
        match &self.counts[seed] {
            SamplesPerPixel::Unknown => 0.0,
            SamplesPerPixel::Uniform(count) => f64::from(*count),
            SamplesPerPixel::PerPixel(counts) => f64::from(counts.planes[0].get(pixel).copied().unwrap_or(0.0)),
        }
    }

    /// Merges a channel of all seeds, pixel by pixel. Values that say nothing do not count if others do.
    fn merged(&self, planes: &[Vec<f32>], nothing: &Nothing) -> impl IndexedParallelIterator<Item = Merged> {
        let pixels = planes.first().map_or(0, Vec::len);
        (0..pixels).into_par_iter().map(move |pixel| self.merged_at(planes, pixel, nothing))
    }

    fn merged_at(&self, planes: &[Vec<f32>], pixel: usize, nothing: &Nothing) -> Merged {
        let seeds = || 0..planes.len();
        let own_count = |seed: usize| self.count(seed, pixel).max(0.0);
        // Where no seed has samples, all count the same.
        let has_none = seeds().all(|seed| own_count(seed) == 0.0);
        let count = |seed: usize| if has_none { 1.0 } else { own_count(seed) };
        let mut halves = [(0.0, 0.0); 2];
        let mut squares = 0.0;
        for seed in seeds() {
            let value = planes[seed][pixel];
            if value.is_finite() && !nothing.is_said(seed, pixel, value) {
                let half = &mut halves[usize::from(!self.in_a[seed])];
                *half = (half.0 + count(seed) * f64::from(value), half.1 + count(seed));
                squares += count(seed) * count(seed) * f64::from(value);
            }
        }
        let [(sum_a, count_a), (sum_b, count_b)] = halves;
        let all = count_a + count_b;
        if all == 0.0 {
            // A value that a seed with samples has, such as the distance of a miss.
            let seed = seeds().find(|seed| count(*seed) > 0.0).unwrap_or(0);
            let value = f64::from(planes[seed][pixel]);
            return Merged { mean: value, spread: Some(0.0), of_squares: value };
        }
        let has_both = count_a > 0.0 && count_b > 0.0;
        let spread = || (sum_a / count_a - sum_b / count_b) * (count_a * count_b).sqrt() / all;
        Merged { mean: (sum_a + sum_b) / all, spread: has_both.then(spread), of_squares: squares / (all * all) }
    }

    fn total(&self) -> SamplesPerPixel {
        if !self.is_known {
            return SamplesPerPixel::Unknown;
        }
        let uniform = self.counts.iter().map(|count| match count {
            SamplesPerPixel::Uniform(count) => Some(*count),
            _ => None,
        });
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
    /// `(A − B)·√(n_A·n_B)/n`: see [`stein::frame::Signal::half_spread`]. `None` where one half has no value.
    spread: Option<f64>,
    /// Σ n_i²·x_i/n², the merged variance of means.
    of_squares: f64,
}

/// Whether a colour or a feature is made of a layer.
fn is_used(set: &BufferSet, planes: &Planes) -> bool {
    set.pictures.iter().flat_map(|picture| picture.signals()).any(|signal| {
        let of_variance = signal.variance.as_ref().map(|variance| &variance.planes);
        let used = [Some(&signal.mean), of_variance].into_iter().flatten();
        used.into_iter().any(|used| (used.file, used.layer) == (planes.file, planes.layer))
    })
}

/// Returns the deviation of each pixel as it shows in the image, if the spread of some pixel is not known.
fn guessed_spreads(merged: &[Merged], extent: Extent) -> Option<Vec<f32>> {
    if merged.iter().all(|merged| merged.spread.is_some()) {
        return None;
    }
    let mean = Image { extent, planes: vec![merged.iter().map(|merged| merged.mean as f32).collect()] };
    let variance = variance_from_image(&mean)?;
    Some(variance.planes[0].iter().map(|variance| variance.max(0.0).sqrt()).collect())
}

/// Values that say nothing.
enum Nothing {
    /// All finite values say something.
    None,
    /// For each seed, whether its ray hit nothing in a pixel: all channels have the value of a miss.
    Misses(Vec<Vec<bool>>),
    /// This variance is not known.
    Value(f32),
}

impl Nothing {
    fn is_said(&self, seed: usize, pixel: usize, value: f32) -> bool {
        match self {
            Self::None => false,
            Self::Misses(misses) => misses[seed][pixel],
            Self::Value(unknown) => value == *unknown,
        }
    }
}

/// The values of a layer in the input and in all seeds, in the window of the input's layer.
struct Column {
    part: usize,
    /// For each channel, the planes of the input and of the seeds.
    channels: Vec<(usize, Vec<Vec<f32>>)>,
}

/// The place of a layer in a seed.
struct Place<'a> {
    file: &'a ExrFile,
    part: usize,
    channels: Vec<usize>,
}

struct Merger<'a> {
    seeds: &'a [Seed],
    request: &'a BufferSetRequest,
    reading: &'a Reading<'a>,
    weights: Vec<Weights>,
    /// The files of both halves, by the position of the file that they are halves of.
    halves: BTreeMap<usize, [ExrFile; 2]>,
    notes: Vec<String>,
    multiplied: Vec<Multiplied>,
}

/// Channels whose values are multiplied before seeds are merged, or the variance of such channels.
#[derive(PartialEq)]
struct Multiplied {
    planes: Planes,
    is_variance: bool,
    kind: MultiplierKind,
    /// The multiplier in the input.
    by: Planes,
}

impl<'a> Merger<'a> {
    fn new(seeds: &'a [Seed], request: &'a BufferSetRequest, reading: &'a Reading<'a>) -> Self {
        let (weights, halves) = (Vec::new(), BTreeMap::new());
        Self { seeds, request, reading, weights, halves, notes: Vec::new(), multiplied: Vec::new() }
    }

    /// Finds the layers that are multiplied by others.
    fn find_multiplied(&mut self, set: &mut BufferSet) {
        for picture in &mut set.pictures {
            let color = &mut picture.color;
            let is_moment = |variance: &mut VarianceSource| variance.quantity == Quantity::SecondMoment;
            if !color.multipliers.is_empty() && color.variance.take_if(|variance| is_moment(variance)).is_some() {
                self.notes.push("colour: a second moment of straight colours of several seeds is not used".into());
            }
            for signal in std::iter::once(&picture.color).chain(picture.payload_signals()) {
                for Multiplier { kind, mean: by, .. } in &signal.multipliers {
                    let variance = signal.variance.as_ref().map(|variance| (&variance.planes, true));
                    for (planes, is_variance) in [(&signal.mean, false)].into_iter().chain(variance) {
                        let multiplied =
                            Multiplied { planes: planes.clone(), is_variance, kind: *kind, by: by.clone() };
                        if !self.multiplied.contains(&multiplied) {
                            self.multiplied.push(multiplied);
                        }
                    }
                }
            }
        }
    }

    /// Multiplies the values of a column by the multipliers of their seeds. A seed without an alpha counts as opaque;
    /// one without a factor has that of the input.
    fn multiply(&self, set: &BufferSet, id: LayerId, column: &mut Column, window: Window) {
        let own = &set.files[0];
        let of_layer = self.multiplied.iter().filter(|it| it.planes.id() == id);
        for Multiplied { planes, is_variance, kind, by } in of_layer {
            let own_part = set.part(by);
            let of_input = || (own, own_part, by.channels.clone());
            for seed in 0..=self.seeds.len() {
                let place = match seed.checked_sub(1).map(|seed| self.seeds[seed].main()) {
                    None => Some(of_input()),
                    Some(file) => source::same_layer(own, file, by)
                        .map(|(part, channels)| (file, part, channels))
                        .or_else(|| (*kind == MultiplierKind::Factor).then(of_input)),
                };
                let Some((file, part, channels)) = place else { continue };
                let by = source::aligned(file.planes(part, &channels), file.data_window(part), window, 0.0).planes;
                for (channel, values) in &mut column.channels {
                    // The layer may have an alpha, too, which is not multiplied.
                    let Some(position) = planes.channels.iter().position(|it| it == channel) else { continue };
                    let by = &by[if by.len() == 1 { 0 } else { position }];
                    if *is_variance {
                        kind.multiply_variance_plane(&mut values[seed], by);
                    } else {
                        kind.multiply_plane(&mut values[seed], by);
                    }
                }
            }
        }
    }

    /// Returns the position of the weights for the layers of a scope in the input.
    fn weights(&mut self, set: &BufferSet, scope: &Scope, part: usize) -> usize {
        if let Some(known) = self.weights.iter().position(|weights| weights.scope == *scope) {
            return known;
        }
        let window = set.files[0].data_window(part);
        let known = |file: &ExrFile, classified: &Classified| {
            if let Some(count) = self.request.samples {
                return SamplesPerPixel::Uniform(count as f32);
            }
            let (files, classified) = (std::slice::from_ref(file), std::slice::from_ref(classified));
            let counted = counts::layer(files, classified, &[0], scope, false);
            let part = part.min(file.parts() - 1);
            let header = counts::in_header(file, part, self.reading.layout, &scope.group);
            counts::known(files, window, header, counted).0
        };
        // The input's own number may come from a file beside it.
        let own = set.pictures.iter().find(|picture| picture.scope == *scope).map(|picture| picture.samples.clone());
        let own = own.unwrap_or_else(|| known(&set.files[0], &self.reading.classified[0]));
        let of_seeds = self.seeds.iter().map(|seed| known(seed.main(), &seed.classified));
        let weights = Weights::new(scope.clone(), window, std::iter::once(own).chain(of_seeds).collect());
        if !weights.is_known {
            let note = "the samples per pixel of some seed are not known: all count the same".to_owned();
            if !self.notes.contains(&note) {
                self.notes.push(note);
            }
        }
        self.weights.push(weights);
        self.weights.len() - 1
    }

    /// Returns the place of a layer in each seed, or the path of a seed that lacks it.
    fn places(&self, set: &BufferSet, planes: &Planes) -> std::result::Result<Vec<Place<'a>>, PathBuf> {
        let own = &set.files[planes.file];
        let window = own.data_window(own.layers[planes.layer].part);
        let place = |seed: &'a Seed| {
            let file = seed.files.get(&planes.file)?;
            let (part, channels) = source::same_layer(own, file, planes)?;
            (source::overlap(file.data_window(part), window) > 0).then_some(Place { file, part, channels })
        };
        self.seeds.iter().map(|seed| place(seed).ok_or_else(|| seed.main().path.clone())).collect()
    }

    /// Returns the values of a layer in all seeds, or the path of a seed that lacks it.
    fn column(&self, set: &BufferSet, planes: &Planes) -> std::result::Result<Column, PathBuf> {
        let own = &set.files[planes.file];
        let part = own.layers[planes.layer].part;
        let window = own.data_window(part);
        let outside = self.outside(planes);
        let aligned = |Place { file, part, channels }: Place<'_>| {
            source::aligned(file.planes(part, &channels), file.data_window(part), window, outside).planes
        };
        let of_seeds: Vec<_> = self.places(set, planes)?.into_iter().map(aligned).collect();
        let channels = planes.channels.iter().enumerate().map(|(position, &channel)| {
            let others = of_seeds.iter().map(|planes| planes[position].clone());
            (channel, std::iter::once(own.plane(part, channel)).chain(others).collect())
        });
        let mut column = Column { part, channels: channels.collect() };
        self.multiply(set, planes.id(), &mut column, window);
        Ok(column)
    }

    fn meaning(&self, planes: &Planes) -> Option<&Meaning> {
        self.reading.classified[planes.file].meanings[planes.layer].as_ref()
    }

    fn rule(&self, planes: &Planes) -> Option<&Rule> {
        self.meaning(planes).map(|meaning| &self.reading.rules.list[meaning.rank.rule])
    }

    /// Returns the value of pixels outside of a seed's data window: a ray that hit nothing.
    fn outside(&self, planes: &Planes) -> f32 {
        let is_distance =
            matches!(self.meaning(planes).and_then(|it| it.role), Some(RoleName::Depth | RoleName::Position));
        let miss = self.rule(planes).and_then(|rule| rule.miss);
        miss.unwrap_or(if is_distance { f32::INFINITY } else { 0.0 })
    }

    /// Returns the values of a layer that say nothing: of a distance where nothing was hit, of a variance that is not
    /// known.
    fn nothing(&self, planes: &Planes, column: &Column) -> Nothing {
        let Some(rule) = self.rule(planes) else { return Nothing::None };
        match (rule.miss, rule.unknown) {
            (Some(miss), _) => {
                let is_miss =
                    |seed: usize, pixel: usize| column.channels.iter().all(|(_, values)| values[seed][pixel] == miss);
                let pixels = column.channels.first().map_or(0, |(_, values)| values[0].len());
                let of_seed = |seed: usize| (0..pixels).map(|pixel| is_miss(seed, pixel)).collect();
                Nothing::Misses((0..=self.seeds.len()).map(of_seed).collect())
            }
            (None, Some(unknown)) => Nothing::Value(unknown),
            (None, None) => Nothing::None,
        }
    }

    /// Makes the halves of all colours and features, and on request of the layers that are denoised along, of the seeds
    /// as they are.
    fn halves(&mut self, set: &mut BufferSet) {
        let first_half = set.files.len();
        for index in 0..set.pictures.len() {
            let mut picture = set.pictures[index].clone();
            let part = set.color_part(index);
            let weights = self.weights(set, &picture.scope, part);
            let color = std::iter::once((&mut picture.color, "colour".to_owned()));
            let features = picture.features.iter_mut().map(|(name, it)| (it, format!("feature {}", text::name(name))));
            let has_halves = |it: &PayloadSource| self.request.payload_halves || it.kind == PayloadKind::Alpha;
            let payload = picture.payload.iter_mut().filter(|it| has_halves(it));
            let payload = payload.map(|it| (&mut it.signal, format!("layer {}", text::name(&it.name))));
            for (source, name) in color.chain(features).chain(payload) {
                // The input's own halves are halves of one seed.
                let own_halves = [&source.half_a, &source.half_b].into_iter().flatten().filter(|half| half.file == 0);
                set.stale.extend(own_halves.map(|half| half.layer));
                (source.half_a, source.half_b) = (None, None);
                let planes = source.mean.clone();
                // Files that were named for the input alone hold one feature for all seeds.
                if !self.reading.own_files.contains(&planes.file) {
                    continue;
                }
                // A luminance stands for three channels.
                let mut once = planes.clone();
                once.channels.dedup();
                match self.column(set, &once) {
                    Ok(column) => {
                        let halves = self.put_halves(set, &planes, &column, weights, first_half);
                        (source.half_a, source.half_b) = (Some(halves[0].clone()), Some(halves[1].clone()));
                    }
                    Err(lacking) => self.notes.push(format!(
                        "{name}: {} lacks it, so that it is of the input alone and has no halves",
                        text::path(&lacking)
                    )),
                }
                let variance = source.variance.as_ref().map(|variance| variance.planes.clone());
                let variance = variance.filter(|planes| self.reading.own_files.contains(&planes.file));
                if let Some(planes) = variance
                    && let Err(lacking) = self.places(set, &planes)
                {
                    source.variance = None;
                    self.notes
                        .push(format!("{name}: {} lacks its variance, so that none is used", text::path(&lacking)));
                }
            }
            set.pictures[index] = picture;
        }
        let files = std::mem::take(&mut self.halves).into_values().flatten();
        set.files.extend(files);
    }

    /// Puts the halves of a signal into the files of the halves, which come behind the set's files. With unequal
    /// numbers of samples, the halves are such that their mean is the merged mean, and their difference has the noise
    /// that equal halves would have.
    fn put_halves(
        &mut self,
        set: &BufferSet,
        planes: &Planes,
        column: &Column,
        weights: usize,
        first_half: usize,
    ) -> [Planes; 2] {
        let nothing = self.nothing(planes, column);
        let window = set.files[planes.file].data_window(column.part);
        let weights = self.weights[weights].in_window(source::window_of(
            &set.files[planes.file],
            column.part,
            self.weights[weights].window,
        ));
        if self.halves.is_empty() {
            for own in self.reading.own_files {
                let half = |in_a: bool| {
                    let mut file = set.files[*own].clone_without_samples();
                    // A half is shown as the first of its seeds.
                    let position = weights.in_a.iter().position(|it| *it == in_a).unwrap_or(0);
                    if let Some(seed) = position.checked_sub(1).and_then(|seed| self.seeds[seed].files.get(own)) {
                        file.path.clone_from(&seed.path);
                    }
                    file
                };
                self.halves.insert(*own, [half(true), half(false)]);
            }
        }
        // Files are in the order of the positions that they belong to.
        let order = self.reading.own_files.iter().filter(|own| **own < planes.file).count();
        let at = first_half + 2 * order;
        let Some(halves) = self.halves.get_mut(&planes.file) else { unreachable!("it was just put there") };
        for (channel, values) in &column.channels {
            let merged: Vec<Merged> = weights.merged(values, &nothing).collect();
            let guessed = guessed_spreads(&merged, window.extent);
            let spreads = merged.iter().enumerate().map(|(pixel, merged)| {
                let guessed = guessed.as_ref().map_or(0.0, |guessed| f64::from(guessed[pixel]));
                // Halves of neighbours are not related, so that the sign alternates.
                (merged.mean, merged.spread.unwrap_or(if pixel % 2 == 0 { guessed } else { -guessed }))
            });
            let (a, b) = spreads.map(|(mean, spread)| ((mean + spread) as f32, (mean - spread) as f32)).unzip();
            halves[0].set_plane(column.part, *channel, a);
            halves[1].set_plane(column.part, *channel, b);
        }
        [0, 1].map(|half| Planes { file: at + half, ..planes.clone() })
    }

    /// Returns the layers of the set's own files in an order in which each comes before the layers by which it is
    /// multiplied, since merging changes these.
    fn in_order(&self, set: &BufferSet) -> Vec<LayerId> {
        let layers = |file: usize| (0..set.files[file].layers.len()).map(move |layer| LayerId { file, layer });
        let mut order: Vec<LayerId> = self.reading.own_files.iter().copied().flat_map(layers).collect();
        order.sort_by_key(|id| {
            let of_layer = || self.multiplied.iter().filter(|it| it.planes.id() == *id);
            let multiplies_others = self.multiplied.iter().any(|it| it.by.id() == *id && it.planes.id() != *id);
            match (of_layer().next(), multiplies_others) {
                (Some(_), false) => 0,
                // A straight colour with its alpha, which is the alpha of other layers, too.
                (Some(_), true) => 1,
                (None, _) => 2,
            }
        });
        order
    }

    /// Replaces the layers that are means or variances of samples by those of all seeds together.
    fn average(&mut self, set: &mut BufferSet) {
        for LayerId { file, layer } in self.in_order(set) {
            let channels = set.files[file].layers[layer].channels.iter().map(|channel| channel.index).collect();
            let planes = Planes { file, layer, channels };
            let Some(quantity) = self.averaged(set, &planes) else { continue };
            let own = &set.files[file].layers[layer];
            let scope = Scope::of(own, self.meaning(&planes));
            let (scope, part) = match set.pictures.as_slice() {
                // Files beside the input belong to its only picture.
                [only] if file > 0 => (only.scope.clone(), set.color_part(0)),
                _ if file > 0 => continue,
                _ => (scope, own.part),
            };
            let mut column = self.column(set, &planes);
            if column.is_err() {
                // A seed may have the layer without its alpha.
                let own = &set.files[file].layers[layer];
                let colors = Planes { channels: own.without_alpha(), ..planes.clone() };
                if colors.channels.len() < planes.channels.len() && !colors.channels.is_empty() {
                    column = self.column(set, &colors).or(column);
                }
            }
            let column = match column {
                Ok(column) => column,
                Err(lacking) => {
                    // Remarks on colours, features and their noise are made with their halves.
                    let own = &set.files[file];
                    if !is_used(set, &planes) && file == 0 {
                        let (layer, lacking) = (own.layers[layer].title(), text::path(&lacking));
                        let layer = text::name(&layer);
                        self.notes.push(format!("layer {layer}: {lacking} lacks it, so that it is of the input alone"));
                    }
                    continue;
                }
            };
            let weights = self.weights(set, &scope, part);
            let nothing = self.nothing(&planes, &column);
            let weights = &self.weights[weights];
            let weights = weights.in_window(source::window_of(&set.files[file], column.part, weights.window));
            set.mark_products(planes.id());
            for (channel, values) in &column.channels {
                let merged: Vec<f32> = match quantity {
                    Quantity::Count => {
                        (0..values[0].len()).map(|pixel| values.iter().map(|plane| plane[pixel]).sum()).collect()
                    }
                    Quantity::VarianceOfMean => {
                        weights.merged(values, &nothing).map(|all| all.of_squares as f32).collect()
                    }
                    _ => weights.merged(values, &nothing).map(|all| all.mean as f32).collect(),
                };
                set.files[file].set_plane(column.part, *channel, merged);
            }
        }
    }

    /// Returns the quantity of a layer that is of all seeds; `None` for layers that stay as the input has them.
    fn averaged(&self, set: &BufferSet, planes: &Planes) -> Option<Quantity> {
        if is_whole_numbers(&set.files[planes.file], planes.layer) {
            return None;
        }
        let is_made_of = |picture: &Picture| picture.is_payload(planes.id()) || picture.is_multiplier(planes.id());
        if set.pictures.iter().any(is_made_of) {
            return Some(Quantity::Mean);
        }
        // A colour that no rule names, or a feature that no rule names but comes with a variance.
        let Some(meaning) = self.meaning(planes) else { return Some(Quantity::Mean).filter(|_| is_used(set, planes)) };
        let described = |meaning: &Meaning| {
            let of = meaning.of?;
            self.reading.classified[of.file].meanings[of.layer].as_ref()?.role
        };
        let role = meaning.role.or_else(|| described(meaning));
        let is_of_samples = role.is_none_or(|role| {
            matches!(role, RoleName::Color | RoleName::Alpha | RoleName::Light) || role.is_feature()
        });
        match meaning.quantity {
            Quantity::Mean if is_of_samples => Some(Quantity::Mean),
            quantity if quantity.is_variance() && is_of_samples => Some(quantity),
            Quantity::Count if role == Some(RoleName::Samples) => Some(Quantity::Count),
            _ => None,
        }
    }

    fn finish(self, set: &mut BufferSet) {
        let mut notes = self.notes;
        for picture in &mut set.pictures {
            let Some(weights) = self.weights.iter().find(|weights| weights.scope == picture.scope) else { continue };
            picture.samples = weights.total();
            picture.samples_layer = None;
            if weights.is_known {
                continue;
            }
            let sources = std::iter::once(&mut picture.color).chain(picture.features.iter_mut().map(|(_, it)| it));
            for source in sources {
                let needs_count = |it: &VarianceSource| it.quantity != Quantity::VarianceOfMean;
                if let Some(variance) = source.variance.take_if(|it| needs_count(it)) {
                    let layer = set.files[variance.planes.file].layers[variance.planes.layer].title();
                    notes.push(format!(
                        "{}: it is a {}, and some seed does not say how many samples it has, so that it is not used",
                        text::name(&layer),
                        variance.quantity
                    ));
                }
            }
        }
        if let (Some(picture), [weights]) = (set.pictures.first(), self.weights.as_slice())
            && let SamplesPerPixel::Uniform(total) = weights.total()
        {
            // Readers of the output learn how many samples it has.
            let names: Vec<String> = counts::attributes(self.reading.layout, &picture.scope.group).collect();
            names.iter().for_each(|name| set.files[0].set_number_attribute(name, total));
        }
        if let Some(weights) = self.weights.first().filter(|_| self.seeds.len() > 1) {
            let paths: Vec<String> = std::iter::once(set.input().to_owned())
                .chain(self.seeds.iter().map(|seed| seed.main().path.clone()))
                .map(|path| text::path(&path))
                .collect();
            let of = |in_a: bool| {
                let names =
                    paths.iter().zip(&weights.in_a).filter(|(_, it)| **it == in_a).map(|(path, _)| path.clone());
                names.collect::<Vec<_>>().join(", ")
            };
            set.notes.push(format!("half A is the mean of {}; half B of {}", of(true), of(false)));
        }
        set.notes.extend(notes);
    }
}
