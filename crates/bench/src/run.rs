//! A run: every set is read, measured with all configurations, and noted in the document.

use std::path::Path;
use std::time::SystemTime;

use stein::frame::{NoiseKnowledge, SamplesPerPixel};
use stein::gpu::AdapterIdentity;
use stein::{Denoiser, Extent, Frame, Gpu, Image, text};
use stein_exr::{BufferSet, BufferSetRequest};
use stein_metric as metric;

use crate::configuration::{PreparedConfiguration, distinct};
use crate::measure::{Case, Contestant, errors, measure, runs};
use crate::observer::Observer;
use crate::sets::SetFile;
use crate::thumbnail::Gallery;
use crate::tile::{cover, cover_frame};
use crate::{Document, Error, Result, Row, SCHEMA, Set, VERSION};

/// Settings of a run.
pub struct Settings<'a> {
    /// Sets to measure.
    pub sets: &'a [SetFile],
    /// Sizes to measure at. The input is repeated, mirrored at the seams, or cut off. Empty: each set's own size.
    pub sizes: &'a [Extent],
    /// Ways to denoise.
    pub configurations: &'a [PreparedConfiguration],
    /// Number of measured runs of each configuration, at least 1.
    pub repeats: u32,
    /// Layers to read of every set, and files beside it. Each set's file takes the place of `input`.
    pub request: BufferSetRequest,
    /// Whether a colour without halves and without variance is refused.
    pub requires_noise: bool,
    /// Whether a set is refused whose halves, variance and visible noise contradict each other.
    pub requires_agreement: bool,
    /// Memory limit on the device, in bytes.
    pub max_memory: Option<u64>,
    /// Whether pictures are kept for the page of a report.
    pub keeps_pictures: bool,
    /// Arguments by which a later run measures the same, for the document.
    pub arguments: Vec<String>,
    /// Notes on what is left out from the beginning, for the document.
    pub notes: Vec<String>,
}

/// A run with its denoisers, ready to measure.
pub struct Bench<'a> {
    gpu: &'a Gpu,
    settings: &'a Settings<'a>,
    contestants: Vec<Contestant<'a>>,
}

/// What a run measured.
pub struct Measured {
    /// Everything but the pictures.
    pub document: Document,
    /// Pictures for the page; empty if none were kept.
    pub gallery: Gallery,
}

impl<'a> Bench<'a> {
    /// Makes the denoisers.
    ///
    /// # Errors
    /// [`Error::Method`] for parameters that are impossible.
    pub fn new(gpu: &'a Gpu, settings: &'a Settings<'a>) -> Result<Self> {
        let denoiser = |method| {
            let denoiser = Denoiser::new(gpu, method).map_err(Error::Method)?;
            Ok(match settings.max_memory {
                Some(bytes) => denoiser.with_max_memory(bytes),
                None => denoiser,
            })
        };
        let contestants = settings.configurations.iter().map(|configuration| Contestant::new(configuration, denoiser));
        Ok(Self { gpu, settings, contestants: contestants.collect::<Result<_>>()? })
    }

    /// Returns the number of runs that [`Bench::run`] will make if nothing is left out.
    pub fn runs(&self) -> u64 {
        self.settings.sets.len() as u64 * runs_of_set(self.settings, &self.contestants)
    }

    /// Measures everything. `scratch` is a folder for the files of other denoisers.
    ///
    /// # Errors
    /// Any [`Error`] of a set, of a device or of another denoiser; [`Error::NothingMeasured`] if no set can be used, and
    /// [`Error::Cancelled`] if the observer ended the run.
    pub fn run(&self, scratch: &Path, observer: &mut dyn Observer) -> Result<Measured> {
        let Settings { sets, configurations, repeats, arguments, notes, .. } = self.settings;
        let document = Document {
            schema: SCHEMA.into(),
            version: VERSION,
            stein: env!("CARGO_PKG_VERSION").into(),
            date: humantime::format_rfc3339_seconds(SystemTime::now()).to_string(),
            arguments: arguments.clone(),
            adapter: AdapterIdentity::from(self.gpu.summary()),
            repeats: *repeats,
            configurations: configurations.iter().map(|configuration| configuration.described.clone()).collect(),
            sets: Vec::new(),
            rows: Vec::new(),
            notes: notes.clone(),
        };
        let mut run = Run {
            gpu: self.gpu,
            settings: self.settings,
            contestants: &self.contestants,
            scratch,
            gallery: Gallery::default(),
            document,
            observer,
        };
        for file in *sets {
            let Some(read) = run.read(file)? else { continue };
            for (set, rows) in run.set(file, read)? {
                run.observer.measured(&set, &rows);
            }
        }
        let Run { document, gallery, .. } = run;
        if document.rows.is_empty() { Err(Error::NothingMeasured) } else { Ok(Measured { document, gallery }) }
    }
}

/// Returns the number of runs that each set takes.
fn runs_of_set(settings: &Settings<'_>, contestants: &[Contestant<'_>]) -> u64 {
    settings.sizes.len().max(1) as u64 * contestants.len() as u64 * runs(settings.repeats)
}

/// A run that is under way.
struct Run<'a> {
    gpu: &'a Gpu,
    settings: &'a Settings<'a>,
    contestants: &'a [Contestant<'a>],
    /// Folder for the files of other programs.
    scratch: &'a Path,
    gallery: Gallery,
    document: Document,
    observer: &'a mut dyn Observer,
}

/// A set in memory.
struct ReadSet {
    frame: Frame,
    reference: Option<Image>,
}

impl Run<'_> {
    /// Reads a set. Returns `None`, with a note, for a file that was found in a folder and cannot be used as a set.
    fn read(&mut self, file: &SetFile) -> Result<Option<ReadSet>> {
        match self.read_set(file) {
            Ok(read) => Ok(Some(read)),
            Err(problem) if file.was_found => {
                let note = self.observer.left_out(problem);
                self.document.notes.push(note);
                self.observer.skipped(runs_of_set(self.settings, self.contestants));
                Ok(None)
            }
            Err(problem) => Err(problem),
        }
    }

    fn read_set(&self, file: &SetFile) -> Result<ReadSet> {
        let in_file = |error: stein::Error| error.in_file(&file.file);
        let request = BufferSetRequest { input: file.file.clone(), ..self.settings.request.clone() };
        let mut set = BufferSet::read(&request).map_err(in_file)?;
        if file.was_found && is_ours(&set) {
            return Err(Error::WrittenByStein { file: file.file.clone() });
        }
        let (frame, repairs) = set.take_frame().map_err(in_file)?;
        if self.settings.requires_noise {
            frame.require_noise(&repairs).map_err(in_file)?;
        }
        if self.settings.requires_agreement {
            frame.check_of_noise().require_agreement().map_err(in_file)?;
        }
        self.check_halves(&frame, &file.file)?;
        let reference = file.reference.as_ref();
        let reference = reference.map(|reference| set.read_reference(0, reference)).transpose()?;
        Ok(ReadSet { frame, reference })
    }

    /// Lists the reduced noise knowledge of the contestants. Contestants that keep all knowledge are not in the list.
    fn noise_knowledges(&self) -> Vec<NoiseKnowledge> {
        let all: Vec<_> = self.contestants.iter().filter_map(Contestant::noise_knowledge).collect();
        distinct(&all, &[])
    }

    fn check_halves(&self, frame: &Frame, file: &Path) -> Result<()> {
        if frame.noise_knowledge().has_halves() || !self.noise_knowledges().into_iter().any(NoiseKnowledge::has_halves)
        {
            return Ok(());
        }
        Err(Error::NoHalves { file: file.to_owned() })
    }

    /// Measures a set at all sizes.
    fn set(&mut self, file: &SetFile, read: ReadSet) -> Result<Vec<(Set, Vec<Row>)>> {
        let ReadSet { frame, reference } = read;
        let samples_per_pixel = mean_samples(&frame);
        let sizes = self.settings.sizes;
        let sizes = if sizes.is_empty() { vec![frame.extent()] } else { sizes.to_vec() };
        let are_given = sizes != [frame.extent()];
        let mut measured = Vec::new();
        for extent in sizes {
            let is_resized = extent != frame.extent();
            let covered;
            let frame = if is_resized {
                covered = cover_frame(&frame, extent)?;
                &covered
            } else {
                &frame
            };
            let reference = reference.as_ref().map(|reference| cover(reference, extent));
            let mut name = file.scene.clone();
            if let Some(samples) = samples_per_pixel {
                name +=
                    &if samples.fract() == 0.0 { format!(", {samples} spp") } else { format!(", {samples:.1} spp") };
            }
            if are_given {
                name += &format!(", {extent}");
            }
            if self.document.sets.iter().any(|other| other.name == name) {
                name += &format!(" ({})", text::path(&file.file));
            }
            let set = Set {
                name,
                scene: file.scene.clone(),
                file: file.file.clone(),
                reference: file.reference.as_ref().map(|reference| reference.file.clone()),
                samples_per_pixel,
                width: extent.width,
                height: extent.height,
                is_resized,
                noisy: reference.as_ref().map(|reference| errors(&frame.color().mean, reference)).transpose()?,
            };
            self.check_halves(frame, &file.file)?;
            let less_known = |knowledge| Some((knowledge, frame.with_noise_known_from(knowledge)?));
            let less_known: Vec<_> = self.noise_knowledges().into_iter().filter_map(less_known).collect();
            let case = Case { set: &set, frame, less_known: &less_known, reference: reference.as_ref() };
            let outcomes =
                measure(self.gpu, self.contestants, &case, self.settings.repeats, self.scratch, self.observer)?;
            if self.settings.keeps_pictures {
                self.gallery.add(&case, &outcomes)?;
            }
            let rows: Vec<Row> = outcomes.into_iter().map(|outcome| outcome.row).collect();
            for row in rows.iter().filter(|row| row.errors.is_some_and(|errors| errors.relative_mse.is_none())) {
                self.document.notes.push(format!(
                    "{}, {}: the result holds values that are not finite, so that it has no errors",
                    row.set, row.configuration
                ));
            }
            self.document.sets.push(set.clone());
            self.document.rows.extend(rows.iter().cloned());
            measured.push((set, rows));
        }
        Ok(measured)
    }
}

/// Whether the file is an output of stein, which may lie beside its input.
fn is_ours(set: &BufferSet) -> bool {
    set.text_attribute("stein.version").is_some()
}

fn mean_samples(frame: &Frame) -> Option<f64> {
    match frame.samples_per_pixel() {
        SamplesPerPixel::Unknown => None,
        SamplesPerPixel::Uniform(count) => Some(f64::from(*count)),
        SamplesPerPixel::PerPixel(counts) => counts.planes.first().map(|plane| metric::mean(plane)),
    }
}
