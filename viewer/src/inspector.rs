//! Which neighbours made a pixel: what was asked of the worker, what came back, and which neighbour is looked at.

use std::sync::Arc;

use stein::kernels::Compared;
use stein::{Extent, FilterKernel, Frame, Image, Kernels, Method};

use crate::layer::{Range, Scale, Shown};
use crate::view::Marked;

/// The least weight that a logarithmic scale tells from 0.
const LEAST_SHOWN: f32 = 1e-3;

/// Which kernels are wanted.
#[derive(Clone, Debug)]
pub struct Question {
    /// Of what.
    pub frame: Arc<Frame>,
    /// How it is denoised.
    pub method: Method,
    /// Column and row.
    pub pixel: [u32; 2],
}

impl PartialEq for Question {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.frame, &other.frame) && self.method == other.method && self.pixel == other.pixel
    }
}

/// The kernels of a pixel, ready to be drawn.
#[derive(Debug)]
pub struct Inspected {
    /// What was asked.
    pub question: Question,
    /// The library's answer.
    pub kernels: Kernels,
    /// One for each of [`Kernels::filters`].
    pub windows: Vec<Window>,
}

/// What is drawn and told of a filter's window.
#[derive(Debug)]
pub struct Window {
    /// [`FilterKernel::weights`].
    pub weights: Shown,
    /// [`FilterKernel::colors`].
    pub colors: Shown,
    /// [`FilterKernel::value`] as an image of one pixel.
    pub value: Shown,
    /// The weights of each of [`FilterKernel::distances`] alone.
    pub alone: Vec<Shown>,
    /// (Σ w)²/Σ w²: as many pixels of equal weight would leave as much noise.
    pub effective_pixels: f32,
    /// Neighbours inside of the frame.
    pub neighbours: usize,
    /// How many of them each distance decided about, in the order of [`FilterKernel::distances`].
    pub decided: Vec<usize>,
}

impl Inspected {
    /// Makes images of an answer.
    pub fn new(question: Question, kernels: Kernels) -> Self {
        let windows = kernels.filters.iter().map(Window::new).collect();
        Self { question, kernels, windows }
    }
}

impl Window {
    fn new(filter: &FilterKernel) -> Self {
        let shown = |image: &Image| Shown::new(Arc::new(image.clone()));
        let value =
            Image { extent: Extent { width: 1, height: 1 }, planes: filter.value.map(|channel| vec![channel]).into() };
        let cells = || 0..filter.weights.extent.pixels();
        let mut decided = vec![0; filter.distances.len()];
        for by in cells().filter_map(|cell| filter.decided_by(cell)) {
            decided[filter.distances.iter().position(|distance| distance.of == by.of).unwrap_or(0)] += 1;
        }
        let squares: f64 = filter.weights.planes[0].iter().map(|weight| f64::from(*weight).powi(2)).sum();
        Self {
            weights: shown(&filter.weights),
            colors: shown(&filter.colors),
            value: shown(&value),
            alone: filter.distances.iter().map(|distance| shown(&distance.weights)).collect(),
            effective_pixels: (f64::from(filter.weight_sum).powi(2) / squares) as f32,
            neighbours: cells().filter(|cell| filter.pixel(*cell).is_some()).count() - 1,
            decided,
        }
    }
}

/// What the window shows.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Quantity {
    /// The weights.
    #[default]
    Weight,
    /// What is averaged.
    Colors,
    /// The weights that one distance alone would give.
    Alone(Compared),
}

/// The kernel's panel: what is there, and what of it is looked at.
#[derive(Debug)]
pub struct Inspector {
    /// The newest answer.
    pub inspected: Option<Arc<Inspected>>,
    /// Which filter, by its place.
    pub filter: usize,
    /// What its window shows.
    pub quantity: Quantity,
    /// How the steps of the scale lie.
    pub scale: Scale,
    /// Whether the pixel under the pointer is the one.
    pub follows: bool,
    /// The neighbour that was clicked, as an offset from the pixel.
    pub kept: Option<[i32; 2]>,
    /// The neighbour under the pointer, in the panel or on the canvas.
    pub pointed: Option<[i32; 2]>,
    waiting: Option<Question>,
    /// The question that there is, or can be, no further answer to.
    settled: Option<Question>,
}

impl Default for Inspector {
    fn default() -> Self {
        let (inspected, waiting, settled, kept, pointed) = Default::default();
        Self {
            inspected,
            filter: 0,
            quantity: Quantity::Weight,
            scale: Scale::Log,
            follows: false,
            kept,
            pointed,
            waiting,
            settled,
        }
    }
}

impl Inspector {
    /// Whether this is neither answered nor asked.
    pub fn asks(&self, question: &Question) -> bool {
        self.waiting.as_ref().or(self.settled.as_ref()) != Some(question)
    }

    /// Remembers what the worker was asked.
    pub fn asked(&mut self, question: Question) {
        self.waiting = Some(question);
    }

    /// Whether an answer is still to come.
    pub fn waits(&self) -> bool {
        self.waiting.is_some()
    }

    /// Takes an answer, if it is still wanted.
    pub fn take(&mut self, inspected: Inspected) {
        if self.waiting.take_if(|waiting| *waiting == inspected.question).is_some() {
            self.settled = Some(inspected.question.clone());
            self.inspected = Some(Arc::new(inspected));
        }
    }

    /// There is no answer.
    pub fn give_up(&mut self) {
        self.settled = self.waiting.take();
        self.inspected = None;
    }

    /// The worker will not answer any more, and can be asked again.
    pub fn forget_question(&mut self) {
        self.waiting = None;
    }

    /// Forgets what belongs to a frame.
    pub fn clear(&mut self) {
        (self.inspected, self.waiting, self.settled, self.pointed) = (None, None, None, None);
    }

    /// The filter that is looked at, and its images. `None` where no answer is there, or nothing is filtered.
    pub fn shown<'a>(&self, inspected: &'a Inspected) -> Option<(&'a FilterKernel, &'a Window)> {
        let place = self.filter.min(inspected.windows.len().checked_sub(1)?);
        Some((&inspected.kernels.filters[place], &inspected.windows[place]))
    }

    /// The cell of the neighbour that is explained.
    pub fn cell(&self, filter: &FilterKernel) -> Option<usize> {
        [self.pointed, self.kept].into_iter().flatten().find_map(|offset| cell_at(filter, offset))
    }

    /// Whether what is there has no neighbour at this offset.
    pub fn lacks(&self, offset: [i32; 2]) -> bool {
        let is_there =
            |inspected: &Inspected| self.shown(inspected).is_some_and(|(filter, _)| cell_at(filter, offset).is_some());
        self.inspected.as_ref().is_some_and(|inspected| !is_there(inspected))
    }

    /// What is drawn on the canvas.
    pub fn marked(&self) -> Option<Marked> {
        let inspected = self.inspected.as_ref()?;
        let (filter, _) = self.shown(inspected)?;
        let neighbour = self.cell(filter).and_then(|cell| filter.pixel(cell)).map(<[u32; 2]>::from);
        Some(Marked { pixel: inspected.question.pixel, radius: filter.window_radius, neighbour })
    }

    /// Ends and steps of the scale of weights: the same for all filters, that they can be compared.
    pub fn scale_of_weights(&self) -> (Range, Scale) {
        (Range { low: if self.scale == Scale::Log { LEAST_SHOWN } else { 0.0 }, high: 1.0 }, self.scale)
    }
}

/// The cell of a neighbour by its offset from the pixel; `None` outside of the window or the frame.
pub fn cell_at(filter: &FilterKernel, offset: [i32; 2]) -> Option<usize> {
    let (side, radius) = (filter.side(), filter.window_radius as i32);
    let [column, row] =
        offset.map(|offset| usize::try_from(offset.saturating_add(radius)).ok().filter(|place| *place < side));
    let cell = row? * side + column?;
    filter.pixel(cell).map(|_| cell)
}

/// The offset of a cell's neighbour from the pixel.
pub fn offset_of(filter: &FilterKernel, cell: usize) -> [i32; 2] {
    let along = |place: usize| place as i32 - filter.window_radius as i32;
    [along(cell % filter.side()), along(cell / filter.side())]
}
