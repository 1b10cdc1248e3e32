//! Actions: everything that a panel, a menu or a key can ask of the window. Panels read a view model and return
//! actions; [`Viewer::apply`](crate::Viewer::apply) is the only place where actions take effect.

use std::borrow::Cow;

use stein::Preset;
use stein::parameters::Value;

use crate::adaptive::Setup;
use crate::document::Source;
use crate::files::Purpose;
use crate::inspector::InspectorAction;
use crate::panel::Panel;
use crate::settings::Parameters;
use crate::sweep::SweepRange;
use crate::view::{Compare, Display};

/// A change of the window, or work to start.
#[derive(Clone, Debug, PartialEq)]
pub enum Action {
    /// Asks the user for a file, and then opens, reads or writes that file.
    AskForFile(Purpose),
    /// Opens files.
    Open(Box<Source>),
    /// Opens the files again that could not be opened without this number of samples per pixel.
    OpenWithSamples(u32),
    /// Opens another picture of the input, by its index.
    ShowPicture(usize),
    /// Opens the next picture of the input, or the previous one for −1.
    StepPicture(isize),
    /// Denoises again.
    Run,
    /// Cancels the work in flight, closes the help, or unpins the pixel.
    Cancel,
    /// Removes the message about a failure.
    Dismiss,

    /// Sets a parameter, by its name. A value that contradicts other parameters waits.
    SetParameter(String, Value),
    /// Chooses a method and a preset, with the parameters that were last used with them.
    ChooseMethod(&'static str, Preset),
    /// Replaces all parameters.
    TakeParameters(Box<Parameters>),
    /// Resets all parameters to those of the preset.
    ResetParameters,

    /// Sets the range of the next sweep.
    SetSweepRange(SweepRange),
    /// Starts to measure error against run time, or stops.
    ToggleSweep,

    /// Sets up the next adaptive loop.
    SetUpLoop(Setup),
    /// Starts an adaptive loop.
    StartLoop,
    /// Ends the adaptive loop; its iterations stay.
    StopLoop,
    /// Shows an iteration of the adaptive loop, by its number.
    ShowIteration(u32),
    /// Shows the next iteration of the adaptive loop, or the previous one for −1.
    StepIteration(i32),

    /// Shows a layer as layer A, if there is a layer with this name.
    ShowLayer {
        /// Name of the layer.
        name: Cow<'static, str>,
        /// Whether the strip scrolls to the layer.
        scrolls: bool,
    },
    /// Shows the next layer of the strip, or the previous one for −1.
    StepLayer(isize),
    /// Records that the strip has scrolled to layer A.
    ScrolledToLayer,
    /// Chooses layer B by its name; `None` chooses no layer.
    SetOther(Option<String>),
    /// Makes the shown layer the one to compare with, layer B.
    MarkOther,
    /// Swaps the layers A and B.
    Swap,
    /// Shows the layer with the same quantity after denoising as layer A, or before for a denoised layer.
    ShowCounterpart,
    /// Compares two layers in this way.
    Compare(Compare),

    /// Replaces all settings that turn values into colours.
    SetDisplay(Box<Display>),
    /// Resets exposure, offset and ranges.
    ResetDisplay,
    /// Brightens the image by this number of stops.
    Expose(f32),
    /// Adds this value to the offset of the colours.
    Offset(f32),
    /// Switches whether layer B is shown on the false-colour scale of layer A.
    ToggleSharedScale,
    /// Fits the image into the view.
    Fit,
    /// Shows one pixel of the image as one pixel of the screen.
    ActualSize,
    /// Magnifies by this factor.
    Zoom(f32),

    /// Pins the pixel at this offset from the chosen pixel.
    MovePixel([i32; 2]),
    /// Changes what the kernel panel shows.
    Inspector(InspectorAction),

    /// Shows a side panel.
    ShowPanel(Panel),
    /// Shows a side panel, or the previous panel if this one is shown already.
    TogglePanel(Panel),
    /// Switches between the dark and the light theme.
    ToggleTheme,
    /// Shows or hides the help.
    ToggleHelp,
}

impl Action {
    /// Returns the action that shows a layer and scrolls the strip to it.
    pub const fn show_layer(name: &'static str) -> Self {
        Self::ShowLayer { name: Cow::Borrowed(name), scrolls: true }
    }
}
