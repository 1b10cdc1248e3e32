//! The viewer, which looks inside a frame that Stein has denoised: what each candidate did, which candidate won where,
//! what the estimated error says, and where samples should go.
//!
//! | room | holds |
//! | --- | --- |
//! | [`app`] | the window: its state, its layout, effects of actions and of replies |
//! | [`action`] | everything that panels, menus and keys can ask of the window |
//! | [`worker`] | one thread that reads and denoises, and the messages to and from it |
//! | [`document`] | the open document: the frame, its reference, the newest run, and all their layers |
//! | [`adaptive`] | the adaptive loop on a built-in scene, whose iterations are opened as they come |
//! | [`layer`] | an image that can be looked at, with its explanation |
//! | [`view`] | the canvas: pan, zoom, comparison; values to colours on the GPU |
//! | [`inspector`] | which neighbours made a pixel: the question, the answer, and the selected neighbour |
//! | [`panel`] | one file per panel beside the canvas: reads a view model, returns actions |
//! | [`shortcut`] | the table of keys, which the help reads as well |
//! | [`screenshot`] | the window without a screen |
//! | [`edit`] | changes of parameters that wait because they contradict other parameters |
//! | [`sweep`] | error against run time |
//! | [`saving`] | files that the window writes |
//! | [`settings`] | settings that are kept from one start to the next |
//! | [`style`] | fonts and colours |
//! | [`words`] | errors of the library, in the words of this program |
//!
//! Each frame goes one way: the window makes view models of its state, panels read them and return
//! [`Action`](action::Action)s, and [`Viewer::apply`] changes the state. The canvas alone changes its own
//! [`View`](view::View): camera, pointer and pinned pixel.
//!
//! The window never waits: it sends slow work to the worker as a [`Request`](worker::Request), and the
//! [`Reply`](worker::Reply) wakes the window. The window rests between frames only if it draws on the processor and the
//! worker is busy.

pub mod action;
pub mod adaptive;
pub mod app;
pub mod device;
pub mod document;
pub mod edit;
pub mod files;
pub mod inspector;
pub mod layer;
pub mod panel;
pub mod saving;
pub mod screenshot;
pub mod settings;
pub mod shortcut;
pub mod style;
pub mod sweep;
pub mod view;
pub mod words;
pub mod worker;

pub use app::{Start, Viewer};
