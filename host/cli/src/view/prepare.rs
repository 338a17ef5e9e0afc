//! A scene with its solver, ready for a session that a page steers; made beside the one that runs.
//!
//! Entry points: [`Wish`], [`Prepared::of`].

use super::settings::{self, Setting, Standing};
use crate::failure::{Cause, Failure};
use std::collections::BTreeMap;
use std::path::PathBuf;
use sutura_host::registry;
use sutura_host::scene::{LONGEST_S, Scene, Sources, Tissue};
use sutura_host::session::{Plan, Rendering, SceneSolver, check_rate};
use sutura_shared::control::TICK_HZ;

/// What a session is to be.
#[derive(Clone, Debug, Default)]
pub struct Wish {
    /// The scene's file; the usual one if none.
    pub scene: Option<PathBuf>,
    /// In place of the scene's.
    pub tissue: Option<Tissue>,
    /// In place of the scene's \[Hz\].
    pub host_hz: Option<f64>,
    /// In place of the tissue's usual one.
    pub rendering: Option<Rendering>,
    /// In place of the scene's hand's \[N/m\] and \[N s/m\].
    pub hand_stiffness_n_per_m: Option<f32>,
    /// See there.
    pub hand_damping_n_s_per_m: Option<f32>,
    /// What the console renders besides.
    pub standing: Standing,
    /// In place of what the scene's file says, see [`settings`](super::settings).
    pub written: BTreeMap<&'static str, f64>,
    /// Whether it is recorded.
    pub is_recorded: bool,
    /// Whether that may write over files that are there.
    pub overwrite: bool,
}

/// A session that can begin.
pub struct Prepared {
    /// What it is.
    pub wish: Wish,
    /// Its scene.
    pub scene: Scene,
    /// All that it takes to read that again.
    pub sources: Sources,
    /// Files that it was read from.
    pub read: Vec<PathBuf>,
    /// How it runs.
    pub plan: Plan,
    /// What can be set of it.
    pub settings: Vec<Setting>,
    /// Ready for the plan.
    pub solver: SceneSolver,
}

impl Prepared {
    /// Reads the scene and makes its solver.
    ///
    /// # Errors
    /// Everything that is wrong with the scene, or that its tissue refuses.
    pub fn of(wish: Wish) -> Result<Prepared, Failure> {
        let document = crate::scene::document(wish.scene.as_deref())?;
        let edited = settings::edited(document.clone(), &wish.written);
        let (mut scene, sources) = crate::scene::open_with_sources(&edited)?;
        if let Some(tissue) = wish.tissue {
            scene.tissue = tissue.instead_of(scene.tissue);
        }
        crate::scene::without_session(&mut scene);
        let mut plan = Plan::of_scene(&scene)?;
        plan.seconds = LONGEST_S;
        plan.host_hz = wish.host_hz.unwrap_or(plan.host_hz);
        plan.rendering = wish.rendering.unwrap_or_else(|| scene.usual_rendering());
        if let Some(stiffness) = wish.hand_stiffness_n_per_m {
            plan.hand.stiffness_n_per_m = stiffness;
        }
        if let Some(damping) = wish.hand_damping_n_s_per_m {
            plan.hand.damping_n_s_per_m = damping;
        }
        let [begin, ..] = plan.hand.way_points;
        plan.fixture = wish.standing.fixture(begin.position_m);
        check_rate(plan.host_hz, TICK_HZ).map_err(|error| {
            Failure::say(
                Cause::BadInput,
                error.to_string(),
                "give a higher --host-hz",
            )
        })?;
        let solver = SceneSolver::for_session(&scene, &plan)?;
        Ok(Prepared {
            settings: Setting::all(&wish, &scene, &plan, &document),
            wish,
            scene,
            sources,
            read: edited.paths(),
            plan,
            solver,
        })
    }

    /// Scenes that can be chosen by name: those beside this one.
    pub fn scenes(&self) -> Vec<String> {
        let files = scene_files(&self.wish).into_iter();
        let mut names: Vec<String> = files
            .filter_map(|path| Some(path.file_stem()?.to_str()?.to_owned()))
            .collect();
        names.sort();
        names
    }

    /// Tissues that can be chosen by name.
    pub fn tissues() -> Vec<String> {
        let entries = registry::entries().into_iter();
        entries.map(|entry| entry.tissue.to_owned()).collect()
    }
}

/// Files of scenes beside that of a wish.
fn scene_files(wish: &Wish) -> Vec<PathBuf> {
    let default = PathBuf::from(crate::scene::DEFAULT);
    let own = wish.scene.as_ref().unwrap_or(&default);
    let folder = own.parent().map(|folder| {
        if folder.as_os_str().is_empty() {
            PathBuf::from(".")
        } else {
            folder.to_owned()
        }
    });
    let entries = folder.and_then(|folder| std::fs::read_dir(folder).ok());
    let paths = entries
        .into_iter()
        .flatten()
        .flatten()
        .map(|entry| entry.path());
    paths
        .filter(|path| path.extension().is_some_and(|end| end == "toml"))
        .collect()
}

impl Wish {
    /// The same of another scene beside this one; none if there is no such.
    pub fn of_scene(&self, name: &str) -> Option<Wish> {
        let files = scene_files(self).into_iter();
        let mut named = files.filter(|path| path.file_stem().is_some_and(|stem| stem == name));
        Some(Wish {
            scene: Some(named.next()?),
            tissue: None,
            rendering: None,
            host_hz: None,
            standing: Standing::default(),
            written: BTreeMap::new(),
            ..self.clone()
        })
    }
}
