//! The viewer: looks inside a frame that Stein has denoised. What each candidate did, which won where, what the
//! estimated error says, where samples should go.
//!
//! | room | holds |
//! | --- | --- |
//! | [`app`] | the window: layout, what keys and messages do |
//! | [`worker`] | one thread that reads and denoises, and the messages to and from it |
//! | [`document`] | what is open: the frame, its reference, the newest run, and the layers that they make |
//! | [`adaptive`] | the adaptive loop on a built-in scene, whose iterations are opened as they come |
//! | [`layer`] | an image that can be looked at, with what explains it |
//! | [`view`] | the canvas: pan, zoom, comparison; values to colours on the GPU |
//! | [`inspector`] | which neighbours made a pixel: what was asked, what came back, what is looked at |
//! | [`panel`] | one file per panel beside the canvas |
//! | [`shortcut`] | the table of keys, which the help reads as well |
//! | [`screenshot`] | the same window without a screen |
//! | [`edit`] | changes of parameters that contradict the others wait here |
//! | [`sweep`] | error against run time |
//! | [`saving`] | files that the window writes |
//! | [`settings`] | what is remembered from one start to the next |
//! | [`words`] | what the library says, in the words of this program |
//!
//! The window never waits: whatever takes time is a [`Request`](worker::Request) to the worker, whose
//! [`Reply`](worker::Reply) wakes the window. Only where the processor plays the graphics card, it rests between frames
//! while the worker is at it.

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
pub mod sweep;
pub mod view;
pub mod words;
pub mod worker;

pub use app::{Start, Viewer};
