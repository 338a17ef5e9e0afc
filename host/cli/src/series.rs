//! `--series DIR`: a session as a row of files for ParaView, made by running its recording again.
//!
//! Entry points: [`Series`]; [`is_file`], for what it writes. Nothing is written while the session runs, so that its loop pays nothing.

use crate::failure::{Cause, Failure};
use std::io;
use std::path::{Path, PathBuf};
use sutura_files::write_whole;
use sutura_host::output::{Drawn, vtu};
use sutura_host::scene::Scene;
use sutura_host::session::SceneSolver;
use sutura_host::thread::{Beats, Hanging};

/// Files a second of the session, unless said otherwise.
pub const SERIES_HZ: f64 = 25.0;

/// A folder that is being filled: one `.vtu` for each picture, and one `.pvd` that lists them with their times.
pub struct Series<'a> {
    folder: &'a Path,
    scene: &'a Scene,
    period_us: f64,
    /// Console time of the first solve \[us\].
    began_us: Option<u64>,
    /// Time of each picture since then \[s\].
    times_s: Vec<f64>,
    /// Threads that hang, from the first solve on.
    hanging: Option<Hanging>,
    beats: Beats,
    broken: Option<(PathBuf, io::Error)>,
}

impl<'a> Series<'a> {
    /// Of a scene, `hz` pictures a second.
    pub fn new(folder: &'a Path, scene: &'a Scene, hz: f64) -> Self {
        Self {
            folder,
            scene,
            period_us: 1e6 / hz,
            began_us: None,
            times_s: Vec::new(),
            hanging: None,
            beats: Beats::default(),
            broken: None,
        }
    }

    /// After a solve: writes a picture if it is time for one.
    pub fn see(&mut self, solver: &SceneSolver, console_time_us: u64) {
        if self.began_us.is_none() {
            self.hanging = solver.model().and_then(|model| Hanging::new(model));
        }
        let began_us = *self.began_us.get_or_insert(console_time_us);
        let tissue = solver.parts().map(|(model, state, _)| (model, state));
        let is_beat = self.beats.is_due(console_time_us);
        let threads = self.hanging.as_mut().zip(tissue);
        if is_beat && let Some((hanging, (model, state))) = threads {
            hanging.beat(console_time_us, model, state, &solver.positions_m());
        }
        let passed_us = console_time_us.saturating_sub(began_us) as f64;
        let due_us = self.times_s.len() as f64 * self.period_us;
        if passed_us < due_us || self.broken.is_some() {
            return;
        }
        let nodes_m = solver.positions_m();
        let threads = self.hanging.as_mut().zip(tissue);
        let free = threads.and_then(|(hanging, (model, state))| {
            hanging.seen(console_time_us, model, state, &nodes_m)
        });
        let drawn = Drawn::of(self.scene, &nodes_m, tissue, free, solver.samples());
        let path = self.folder.join(file(self.times_s.len()));
        match write_whole(&path, vtu(&drawn).as_bytes()) {
            Ok(()) => self.times_s.push(passed_us / 1e6),
            Err(error) => self.broken = Some((path, error)),
        }
    }

    /// Writes the list; returns where it is and how many pictures it names.
    ///
    /// # Errors
    /// A file that could not be written.
    pub fn finish(mut self) -> Result<(PathBuf, usize), Failure> {
        let path = self.folder.join(LIST);
        let mut list = String::from(
            "<?xml version=\"1.0\"?>\n<VTKFile type=\"Collection\" version=\"1.0\">\n<Collection>\n",
        );
        for (number, time_s) in self.times_s.iter().enumerate() {
            let file = file(number);
            list += &format!("<DataSet timestep=\"{time_s}\" file=\"{file}\"/>\n");
        }
        list += "</Collection>\n</VTKFile>\n";
        if self.broken.is_none() {
            let written = write_whole(&path, list.as_bytes());
            self.broken = written.err().map(|error| (path.clone(), error));
        }
        match self.broken {
            None => Ok((path, self.times_s.len())),
            Some((path, error)) => {
                let message = format!("cannot write {}: {error}", path.display());
                let help = "what was written before stays; make room, or write fewer pictures with --series-hz";
                Err(Failure::say(Cause::Failed, message, help))
            }
        }
    }
}

/// Name of the list.
const LIST: &str = "session.pvd";

/// Name of a picture's file.
fn file(number: usize) -> String {
    format!("session-{number:05}.vtu")
}

/// Whether a folder's file of this name would be written.
pub fn is_file(name: &str) -> bool {
    let number = name
        .strip_prefix("session-")
        .and_then(|rest| rest.strip_suffix(".vtu"));
    let number = number.and_then(|number| number.parse().ok());
    name == LIST || number.is_some_and(|number| file(number) == name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_files_of_a_series_are_known_by_their_names() {
        for name in [&file(0), &file(99), &file(123_456), LIST] {
            assert!(is_file(name), "{name}");
        }
        for name in [
            "session.mcap",
            "session-1.vtu",
            "session-0000a.vtu",
            "session-00001.vtk",
            "session-+0001.vtu",
        ] {
            assert!(!is_file(name), "{name}");
        }
    }
}
