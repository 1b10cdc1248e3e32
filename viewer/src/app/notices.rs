//! Messages of the window to the user.

use eframe::egui::Context;
use stein::error::RequestCause;

use super::Viewer;
use crate::worker::Task;

/// Time for which the notice of a written file is shown, in seconds.
pub(super) const NOTICE_SECONDS: f64 = 8.0;

impl Viewer {
    /// Shows the reason why a file cannot be opened.
    pub(super) fn refuse(&mut self, problem: &str, remedy: &str) {
        let cause = RequestCause::Other { problem: problem.into(), remedy: remedy.into() };
        self.trouble = Some((Task::Open, stein::Error::Request(cause)));
    }

    /// Shows a message about files; see [`Viewer::notice`].
    pub(super) fn tell(&mut self, notice: stein::Result<String>, context: &Context) {
        self.notice = Some((notice, context.input(|input| input.time)));
        context.request_repaint_after_secs(NOTICE_SECONDS as f32);
    }

    /// Reports layers, pixel and neighbour of the start that do not exist, and shows the defaults instead. Does so
    /// once, after the first run.
    pub(super) fn check_names(&mut self) {
        let Some(document) = self.document.as_ref().filter(|document| document.denoised.is_some()) else { return };
        // The last iteration still adds layers, and an earlier failure must stay visible.
        if !self.checks_names || self.adaptive.is_running || self.inspector.waits() || self.trouble.is_some() {
            return;
        }
        self.checks_names = false;
        let mut missing: Vec<(String, String)> = Vec::new();
        let is_unknown = |name: &&String| document.layer(name).is_none();
        let mut unknown: Vec<_> = [Some(&self.view.layer), self.view.other.as_ref()]
            .into_iter()
            .flatten()
            .filter(is_unknown)
            .cloned()
            .collect();
        unknown.dedup();
        if !unknown.is_empty() {
            let names: Vec<_> = document.layers().iter().map(|layer| layer.name()).collect();
            missing.push((
                format!("there is no layer '{}'", unknown.join("' or '")),
                format!("choose one of {}", names.join(", ")),
            ));
        }
        let extent = document.opened.frame.extent();
        let outside = self.view.pinned.filter(|[x, y]| *x >= extent.width || *y >= extent.height);
        if let Some([x, y]) = outside {
            missing.push((
                format!("there is no pixel ({x}, {y})"),
                format!("the image has {extent} pixels, counted from 0"),
            ));
        }
        let lost = self.inspector.kept.filter(|offset| self.inspector.lacks(*offset));
        if let Some([dx, dy]) = lost {
            missing.push((
                format!("the window has no neighbour ({dx}, {dy}) in the image"),
                "choose an offset within the radius of the window".into(),
            ));
        }
        if missing.is_empty() {
            return;
        }
        if unknown.contains(&self.view.layer) {
            self.view.layer = "result".into();
            self.scrolls_to_layer = true;
        }
        if self.view.other.take_if(|other| unknown.contains(other)).is_some() {
            self.compare(self.view.compare);
        }
        self.view.pinned.take_if(|_| outside.is_some());
        self.inspector.kept.take_if(|_| lost.is_some());
        let (problems, remedies): (Vec<_>, Vec<_>) = missing.into_iter().unzip();
        self.refuse(&problems.join("; "), &remedies.join("; "));
    }
}
