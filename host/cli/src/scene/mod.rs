//! Opening the scene that a command was given, or the one that it has by itself.
//!
//! Entry point: [`open`]; [`command`] is `sutura scene`.

pub mod command;

use crate::failure::{Cause, Failure, render};
use miette::Report;
use std::path::Path;
use sutura_host::recording::Recording;
use sutura_host::scene::{self, Document, Scene, SceneError, Sources, Tissue};

/// Where the default scene is, seen from a checkout's root.
pub const DEFAULT: &str = "scenes/palpation.toml";
/// The same scene for use anywhere else.
const EMBEDDED: &str = include_str!("../../../../scenes/palpation.toml");
/// The palpation without friction, against which times are compared.
const FRICTIONLESS: &str = include_str!("../../../../scenes/palpation-frictionless.toml");

/// The line of it that says how fine the slab is.
const DIVISIONS: &str = "divisions = [20, 20, 8]";

/// Loads a scene and shows its warnings; without a path it is [`DEFAULT`], or the copy of it inside this
/// program where there is no such file.
///
/// # Errors
/// Bad input: the file, something in it, or a file that it names.
pub fn open(path: Option<&Path>) -> Result<Scene, Failure> {
    let document = document(path)?;
    Ok(show(scene::read(&document)?))
}

/// As [`open`], of a document that has been read, with all that it takes to read the scene again elsewhere.
///
/// # Errors
/// As there.
pub fn open_with_sources(document: &Document) -> Result<(Scene, Sources), Failure> {
    let scene = show(scene::read(document)?);
    Ok((scene, document.sources()))
}

/// The scene's file, before its mesh is made.
///
/// # Errors
/// Bad input: the file.
pub fn document(path: Option<&Path>) -> Result<Document, SceneError> {
    match path {
        Some(path) => Document::read(path),
        None if Path::new(DEFAULT).is_file() => Document::read(Path::new(DEFAULT)),
        None => Ok(Document::embedded(
            "palpation.toml",
            Path::new(""),
            EMBEDDED,
        )),
    }
}

/// The scene of a recording.
///
/// # Errors
/// As [`open`].
pub fn recorded(recording: &Recording) -> Result<Scene, Failure> {
    Ok(show(recording.scene()?))
}

/// A tissue instead of `auto`, which only sessions choose.
pub fn without_session(scene: &mut Scene) {
    if scene.tissue == Tissue::Auto {
        note!("`auto` tissue is chosen when a session begins: linear tissue stands in for it here");
        scene.tissue = Tissue::Linear;
    }
}

/// A loaded scene; its warnings, and what its mesh's reader says, are shown.
fn show(mut scene: Scene) -> Scene {
    for warning in scene.warnings.drain(..) {
        render(&Report::new(warning));
    }
    for said in scene.mesh_notes.drain(..) {
        note!("{said}");
    }
    tracing::info!(
        "scene \"{}\": {} nodes, {} cells, {} tools, {} handles",
        scene.name,
        scene.mesh.points_m().len(),
        scene.mesh.cells().len(),
        scene.tools.len(),
        scene.loads.handles.len()
    );
    scene
}

/// The palpation without friction, for figures that stay comparable.
///
/// # Errors
/// None unless the shipped scene is not sound.
pub fn frictionless() -> Result<Scene, Failure> {
    let document = Document::embedded("palpation-frictionless.toml", Path::new(""), FRICTIONLESS);
    Ok(show(scene::read(&document)?))
}

/// The same on a slab of these divisions.
///
/// # Errors
/// Bad input, for divisions that make no slab.
pub fn palpation_on(divisions: [usize; 3]) -> Result<Scene, Failure> {
    let [x, y, z] = divisions;
    let text = FRICTIONLESS.replacen(DIVISIONS, &format!("divisions = [{x}, {y}, {z}]"), 1);
    let document = Document::embedded("palpation-frictionless.toml", Path::new(""), &text);
    let mut scene = Scene::read(&document, "palpation")?;
    scene.name = format!("palpation {x} x {y} x {z}");
    Ok(scene)
}

impl From<SceneError> for Failure {
    fn from(error: SceneError) -> Failure {
        Failure::new(Cause::BadInput, error)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_suite_changes_the_mesh_and_nothing_else() {
        let scene = palpation_on([6, 5, 4]).expect("the embedded scene is good");
        assert_eq!(scene.mesh.points_m().len(), 7 * 6 * 5);
        let own = frictionless().expect("the embedded scene is good");
        assert_eq!(
            (own.hand, own.host, &own.tools),
            (scene.hand, scene.host, &scene.tools)
        );
    }
}
