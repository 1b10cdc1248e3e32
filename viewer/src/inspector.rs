//! Which neighbours made a pixel: the question to the worker, its answer, and the selected neighbour.

use std::sync::Arc;

use stein::kernels::Compared;
use stein::{Extent, FilterKernel, Frame, Image, Kernels, Method};

use crate::layer::{Range, Scale, Shown};
use crate::view::Marked;

/// Smallest weight that a logarithmic scale distinguishes from 0.
const LEAST_SHOWN: f32 = 1e-3;

/// A request for the kernels of a pixel.
#[derive(Clone, Debug)]
pub struct Question {
    /// Frame with the pixel.
    pub frame: Arc<Frame>,
    /// Method that denoises the frame.
    pub method: Method,
    /// Pixel, [column, row].
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
    /// Question that is answered.
    pub question: Question,
    /// Kernels from the library.
    pub kernels: Kernels,
    /// Windows of the filters, one for each of [`Kernels::filters`].
    pub windows: Vec<FilterWindow>,
}

/// Images and numbers of a filter's window.
#[derive(Debug)]
pub struct FilterWindow {
    /// Image of [`FilterKernel::weights`].
    pub weights: Shown,
    /// Image of [`FilterKernel::colors`].
    pub colors: Shown,
    /// [`FilterKernel::value`] as an image of one pixel.
    pub value: Shown,
    /// Images of the weights that each of [`FilterKernel::distances`] would give by itself.
    pub alone: Vec<Shown>,
    /// Effective number of pixels, (Σ w)²/Σ w²: this number of pixels of equal weight would leave as much noise.
    pub effective_pixels: f32,
    /// Number of neighbours inside of the frame.
    pub neighbours: usize,
    /// Numbers of neighbours that each distance decided about, in the order of [`FilterKernel::distances`].
    pub decided: Vec<usize>,
}

impl Inspected {
    /// Makes the images of an answer.
    pub fn new(question: Question, kernels: Kernels) -> Self {
        let windows = kernels.filters.iter().map(FilterWindow::new).collect();
        Self { question, kernels, windows }
    }
}

impl FilterWindow {
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

/// Quantity that the window shows.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Quantity {
    /// The weights.
    #[default]
    Weight,
    /// The colours that are averaged.
    Colors,
    /// The weights that one distance alone would give.
    Alone(Compared),
}

/// A change of what the kernel panel shows.
#[derive(Clone, Debug, PartialEq)]
pub enum InspectorAction {
    /// Selects a filter by its index.
    SelectFilter(usize),
    /// Shows this quantity in the window of the filter.
    ShowQuantity(Quantity),
    /// Shows the weights on this scale.
    SetScale(Scale),
    /// Switches whether the panel follows the pointer.
    ToggleFollow,
    /// Keeps the neighbour at this offset from the pixel; `None` keeps no neighbour.
    Keep(Option<[i32; 2]>),
    /// Records the neighbour under the pointer, as an offset from the pixel; `None` if there is no such neighbour.
    Point(Option<[i32; 2]>),
}

/// State of the kernel panel: the newest answer and the selection of the user.
#[derive(Debug)]
pub struct Inspector {
    /// The newest answer.
    pub inspected: Option<Arc<Inspected>>,
    /// Index of the selected filter.
    pub filter: usize,
    /// Quantity that the window of the filter shows.
    pub quantity: Quantity,
    /// Scale of the weights.
    pub scale: Scale,
    /// Whether the kernels of the pixel under the pointer are shown.
    pub follows: bool,
    /// Neighbour that was clicked, as an offset from the pixel.
    pub kept: Option<[i32; 2]>,
    /// Neighbour under the pointer, in the panel or on the canvas, as an offset from the pixel.
    pub pointed: Option<[i32; 2]>,
    waiting: Option<Question>,
    /// Question that was answered or that failed, and is not sent again.
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
    /// Changes what the panel shows.
    pub fn apply(&mut self, action: InspectorAction) {
        match action {
            InspectorAction::SelectFilter(index) => self.filter = index,
            InspectorAction::ShowQuantity(quantity) => self.quantity = quantity,
            InspectorAction::SetScale(scale) => self.scale = scale,
            InspectorAction::ToggleFollow => self.follows = !self.follows,
            InspectorAction::Keep(offset) => self.kept = offset,
            InspectorAction::Point(offset) => self.pointed = offset,
        }
    }

    /// Returns whether this question is neither answered nor pending.
    pub fn asks(&self, question: &Question) -> bool {
        self.waiting.as_ref().or(self.settled.as_ref()) != Some(question)
    }

    /// Records the pending request so that its reply can be matched.
    pub fn asked(&mut self, question: Question) {
        self.waiting = Some(question);
    }

    /// Returns whether an answer is still to come.
    pub fn waits(&self) -> bool {
        self.waiting.is_some()
    }

    /// Takes an answer, if its question is the pending one.
    pub fn take(&mut self, inspected: Inspected) {
        if self.waiting.take_if(|waiting| *waiting == inspected.question).is_some() {
            self.settled = Some(inspected.question.clone());
            self.inspected = Some(Arc::new(inspected));
        }
    }

    /// Records that the pending question has no answer.
    pub fn give_up(&mut self) {
        self.settled = self.waiting.take();
        self.inspected = None;
    }

    /// Forgets the pending question, which the worker will not answer any more, so that it can be sent again.
    pub fn forget_question(&mut self) {
        self.waiting = None;
    }

    /// Forgets everything that belongs to a frame.
    pub fn clear(&mut self) {
        (self.inspected, self.waiting, self.settled, self.pointed) = (None, None, None, None);
    }

    /// Returns the selected filter and its images; `None` if the answer has no filters.
    pub fn shown<'a>(&self, inspected: &'a Inspected) -> Option<(&'a FilterKernel, &'a FilterWindow)> {
        let place = self.filter.min(inspected.windows.len().checked_sub(1)?);
        Some((&inspected.kernels.filters[place], &inspected.windows[place]))
    }

    /// Returns the cell of the neighbour to explain: the one under the pointer, or else the one that was clicked.
    pub fn cell(&self, filter: &FilterKernel) -> Option<usize> {
        explained_cell(filter, self.pointed, self.kept)
    }

    /// Returns whether the answer has no neighbour at this offset; `false` without an answer.
    pub fn lacks(&self, offset: [i32; 2]) -> bool {
        let is_there =
            |inspected: &Inspected| self.shown(inspected).is_some_and(|(filter, _)| cell_at(filter, offset).is_some());
        self.inspected.as_ref().is_some_and(|inspected| !is_there(inspected))
    }

    /// Returns the pixels to mark on the canvas.
    pub fn marked(&self) -> Option<Marked> {
        let inspected = self.inspected.as_ref()?;
        let (filter, _) = self.shown(inspected)?;
        let neighbour = self.cell(filter).and_then(|cell| filter.pixel(cell)).map(<[u32; 2]>::from);
        Some(Marked { pixel: inspected.question.pixel, radius: filter.window_radius, neighbour })
    }

    /// Returns the ends and the steps of the scale of weights. All filters share them, so that they can be compared.
    pub fn scale_of_weights(&self) -> (Range, Scale) {
        (Range { low: if self.scale == Scale::Log { LEAST_SHOWN } else { 0.0 }, high: 1.0 }, self.scale)
    }
}

/// Returns the cell of the neighbour to explain: the one under the pointer, or else the one that was clicked. Both are
/// offsets from the pixel.
pub fn explained_cell(filter: &FilterKernel, pointed: Option<[i32; 2]>, kept: Option<[i32; 2]>) -> Option<usize> {
    [pointed, kept].into_iter().flatten().find_map(|offset| cell_at(filter, offset))
}

/// Returns the cell of a neighbour by its offset from the pixel; `None` outside of the window or the frame.
pub fn cell_at(filter: &FilterKernel, offset: [i32; 2]) -> Option<usize> {
    let (side, radius) = (filter.side(), filter.window_radius as i32);
    let [column, row] =
        offset.map(|offset| usize::try_from(offset.saturating_add(radius)).ok().filter(|place| *place < side));
    let cell = row? * side + column?;
    filter.pixel(cell).map(|_| cell)
}

/// Returns the offset of a cell's neighbour from the pixel.
pub fn offset_of(filter: &FilterKernel, cell: usize) -> [i32; 2] {
    let along = |place: usize| place as i32 - filter.window_radius as i32;
    [along(cell % filter.side()), along(cell / filter.side())]
}
