//! Keys: one table that the input handling and the help overlay read.

use eframe::egui::{Context, Key, KeyboardShortcut, Modifiers};

use crate::action::Action;
use crate::files::Purpose;
use crate::inspector::InspectorAction;
use crate::panel::Panel;
use crate::view::Compare;

/// A key, its effect, and the description of the effect in the help.
#[derive(Clone, Debug)]
pub struct Shortcut {
    /// The key with its modifiers.
    pub keys: KeyboardShortcut,
    /// Effect of the key.
    pub action: Action,
    /// Description in the help; empty if an earlier line of the help lists this key as well.
    pub about: &'static str,
}

/// A section of the help.
#[derive(Clone, Debug)]
pub struct Section {
    /// Heading of the section.
    pub title: &'static str,
    /// Keys of the section, in the order of the help.
    pub shortcuts: &'static [Shortcut],
}

const COMMAND_SHIFT: Modifiers = Modifiers { shift: true, ..Modifiers::COMMAND };

const fn key(key: Key, action: Action, about: &'static str) -> Shortcut {
    Shortcut { keys: KeyboardShortcut::new(Modifiers::NONE, key), action, about }
}

const fn with(modifiers: Modifiers, key: Key, action: Action, about: &'static str) -> Shortcut {
    Shortcut { keys: KeyboardShortcut::new(modifiers, key), action, about }
}

/// All keys. Those with the most modifiers are tried first, so that `Shift+E` is not taken for `E`.
pub const SECTIONS: &[Section] = &[
    Section {
        title: "File and run",
        shortcuts: &[
            with(Modifiers::COMMAND, Key::O, Action::AskForFile(Purpose::Input), "open a buffer set"),
            with(Modifiers::COMMAND, Key::R, Action::AskForFile(Purpose::Reference), "open a reference"),
            with(Modifiers::COMMAND, Key::S, Action::AskForFile(Purpose::SaveResult), "save the result"),
            with(Modifiers::COMMAND, Key::E, Action::AskForFile(Purpose::SaveView), "save the view as PNG"),
            with(COMMAND_SHIFT, Key::E, Action::AskForFile(Purpose::SaveLayer), "save the layer as PNG"),
            with(
                Modifiers::COMMAND,
                Key::P,
                Action::AskForFile(Purpose::SaveParameters),
                "save the parameters as TOML",
            ),
            with(COMMAND_SHIFT, Key::P, Action::AskForFile(Purpose::Parameters), "load parameters"),
            with(Modifiers::COMMAND, Key::Backspace, Action::ResetParameters, "all parameters as in the preset"),
            key(Key::F5, Action::Run, "denoise again"),
            key(Key::F9, Action::ToggleSweep, "measure error against time, or stop"),
            key(Key::Escape, Action::Cancel, "cancel, close the help, unpin the pixel"),
        ],
    },
    Section {
        title: "Layers",
        shortcuts: &[
            key(Key::Period, Action::StepLayer(1), "next layer"),
            key(Key::Comma, Action::StepLayer(-1), "layer before"),
            key(Key::PageDown, Action::StepIteration(1), "next iteration of sampling"),
            key(Key::PageUp, Action::StepIteration(-1), "iteration before"),
            key(Key::Num1, Action::show_layer("result"), "result"),
            key(Key::Num2, Action::show_layer("noisy"), "noisy"),
            key(Key::Num3, Action::show_layer("reference"), "reference"),
            key(Key::Num4, Action::show_layer("first"), "FIRST"),
            key(Key::Num5, Action::show_layer("second"), "SECOND"),
            key(Key::Num6, Action::show_layer("third"), "THIRD"),
            key(Key::Num7, Action::show_layer("selection"), "selection"),
            key(Key::Num8, Action::show_layer("error"), "estimated error"),
            key(Key::Num9, Action::show_layer("density"), "sampling density"),
        ],
    },
    Section {
        title: "Compare",
        shortcuts: &[
            key(Key::M, Action::MarkOther, "compare with this layer (B)"),
            key(Key::X, Action::Swap, "swap the layers A and B"),
            key(Key::C, Action::ShowCounterpart, "the same layer before or after denoising"),
            key(Key::A, Action::Compare(Compare::Single), "layer A alone"),
            key(Key::S, Action::Compare(Compare::SideBySide), "side by side"),
            key(Key::W, Action::Compare(Compare::Wipe), "wipe"),
            key(Key::B, Action::Compare(Compare::Blink), "blink"),
            key(Key::D, Action::Compare(Compare::Difference), "signed difference A − B"),
            key(Key::R, Action::Compare(Compare::Relative), "relative difference"),
            key(Key::L, Action::ToggleSharedScale, "one scale for A and B"),
        ],
    },
    Section {
        title: "View",
        shortcuts: &[
            key(Key::P, Action::StepPicture(1), "next picture of the file"),
            with(Modifiers::SHIFT, Key::P, Action::StepPicture(-1), "picture before"),
            key(Key::F, Action::Fit, "fit the image"),
            key(Key::Num0, Action::ActualSize, "one pixel to one"),
            key(Key::Plus, Action::Zoom(1.25), "magnify"),
            key(Key::Equals, Action::Zoom(1.25), ""),
            key(Key::Minus, Action::Zoom(0.8), "reduce"),
            key(Key::E, Action::Expose(0.5), "half a stop brighter"),
            with(Modifiers::SHIFT, Key::E, Action::Expose(-0.5), "half a stop darker"),
            key(Key::O, Action::Offset(0.05), "offset up"),
            with(Modifiers::SHIFT, Key::O, Action::Offset(-0.05), "offset down"),
            key(Key::N, Action::ResetDisplay, "reset exposure, offset and ranges"),
        ],
    },
    Section {
        title: "Pixel and kernel",
        shortcuts: &[
            key(Key::ArrowLeft, Action::MovePixel([-1, 0]), "one pixel left"),
            key(Key::ArrowRight, Action::MovePixel([1, 0]), "one pixel right"),
            key(Key::ArrowUp, Action::MovePixel([0, -1]), "one pixel up"),
            key(Key::ArrowDown, Action::MovePixel([0, 1]), "one pixel down"),
            with(Modifiers::SHIFT, Key::ArrowLeft, Action::MovePixel([-10, 0]), "ten pixels left"),
            with(Modifiers::SHIFT, Key::ArrowRight, Action::MovePixel([10, 0]), "ten pixels right"),
            with(Modifiers::SHIFT, Key::ArrowUp, Action::MovePixel([0, -10]), "ten pixels up"),
            with(Modifiers::SHIFT, Key::ArrowDown, Action::MovePixel([0, 10]), "ten pixels down"),
            key(Key::K, Action::TogglePanel(Panel::Kernel), "kernel, and back"),
            with(
                Modifiers::SHIFT,
                Key::K,
                Action::Inspector(InspectorAction::ToggleFollow),
                "kernel under the pointer (as while Ctrl is held)",
            ),
        ],
    },
    Section {
        title: "Panels",
        shortcuts: &[
            key(Key::F1, Action::ShowPanel(Panel::Display), "display"),
            key(Key::F2, Action::ShowPanel(Panel::Parameters), "parameters"),
            key(Key::F3, Action::ShowPanel(Panel::Pixel), "pixel"),
            key(Key::F4, Action::ShowPanel(Panel::Report), "report"),
            key(Key::F7, Action::ShowPanel(Panel::Plot), "error against time"),
            key(Key::F8, Action::ShowPanel(Panel::Sampling), "sampling"),
            key(Key::T, Action::ToggleTheme, "dark or light"),
            key(Key::H, Action::ToggleHelp, "this help"),
            key(Key::Questionmark, Action::ToggleHelp, ""),
        ],
    },
];

/// Returns the actions of the keys that were pressed in this frame; nothing while a text is edited.
pub fn pressed(context: &Context) -> Vec<Action> {
    if context.egui_wants_keyboard_input() {
        return Vec::new();
    }
    let mut all: Vec<&Shortcut> = SECTIONS.iter().flat_map(|section| section.shortcuts).collect();
    let modifiers = |Modifiers { alt, ctrl, shift, command, .. }: Modifiers| {
        [alt, ctrl || command, shift].into_iter().filter(|held| *held).count()
    };
    all.sort_by_key(|shortcut| std::cmp::Reverse(modifiers(shortcut.keys.modifiers)));
    context.input_mut(|input| {
        all.into_iter()
            .filter(|shortcut| input.consume_shortcut(&shortcut.keys))
            .map(|shortcut| shortcut.action.clone())
            .collect()
    })
}
