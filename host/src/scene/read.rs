//! From what a scene file says to a checked [`Scene`].
//!
//! Entry point: [`Scene::read`]. The first thing that is wrong ends it, with its place in the file.

use super::added;
use super::bodies::{idle_pairs, read_body_contacts};
use super::device::find_device_warned;
use super::document::{Document, Flaw, SceneError};
use super::gravity::{read_densities, read_gravity, read_settle, weigh_needles};
use super::hand::{beyond_device, hand_script};
use super::jaws::read_jaws;
use super::needles::{read_needle_solver, read_needle_tissue, read_needles};
use super::parts::{read_parts, read_slab};
use super::reach::out_of_reach;
use super::region::{Made, read_materials};
use super::select::{check_nodes, select};
use super::threads::{idle_grips, read_threads};
use super::tools::read_tools;
use super::touching::read_touching;
use super::units;
use super::{
    Corotational, DENSITY_KG_PER_M3, HostSettings, Part, Places, Registered, Scene, Tissue,
};
use crate::fem::{Anchor, Handle, Loads, NodeLoad};
use crate::mesh::{self, MeshError, TetMesh};
use miette::Severity;
use sutura_scene_file::scene::{
    HandleSection, LoadSection, MeshSection, RelaxationSection, SceneFile, TissueModel,
    TissueSection,
};
use toml::Spanned;

/// Length of a session when the scene does not say \[s\].
const SECONDS: f64 = 5.0;
/// Longest session \[s\]: a day, which the console's 32-bit tick count holds.
pub const LONGEST_S: f64 = 86_400.0;
/// Solver steps a second when the scene does not say \[Hz\]: half of what a slab of some thousand nodes
/// allows on a small desktop machine.
const HOST_HZ: f64 = 200.0;
/// What every console caps the horizon at \[ms\].
const HORIZON_CAP_MS: f64 = 150.0;

impl Scene {
    /// Checks a scene that is already in memory; `name` is used if it does not name itself.
    ///
    /// # Errors
    /// The first thing that is wrong, at its place in the document.
    pub fn read(document: &Document, name: &str) -> Result<Scene, SceneError> {
        let (file, added) = added::read(document)?;
        let (mesh, mesh_notes) = read_mesh(document, &file.mesh)?;
        let (mut warnings, mut notes) = (Vec::new(), Vec::new());
        let Made {
            materials,
            regions,
            of_cell,
        } = read_materials(document, &mesh, &file.tissue, &file.region, &mut warnings)?;
        warnings.extend(units::of_mesh(document, &file.mesh, &mesh));
        let mut fixed: Vec<u32> = Vec::new();
        let mut fixed_by = Vec::new();
        for selection in &file.fixed {
            let mut own = select(document, &mesh, selection)?;
            own.retain(|node| fixed.binary_search(node).is_err());
            fixed.extend(&own);
            fixed.sort_unstable();
            fixed_by.push(own);
        }
        if fixed.is_empty() {
            let help = "add `[[fixed]]` with `plane`, `box` or `nodes`: free tissue has no rest under load";
            let message = "nothing holds the tissue";
            return Err(document.flaw(
                file.mesh.span(),
                message,
                "none of it is fixed",
                Some(help),
            ));
        }
        let device = match &file.device {
            Some(name) => {
                let (device, warned) = find_device_warned(document, name)?;
                warnings.extend(warned);
                Some(device)
            }
            None => None,
        };
        let hand = match (&file.hand, &device) {
            (Some(section), Some(device)) => Some(hand_script(
                document,
                section.get_ref(),
                &device.description,
            )?),
            (Some(section), None) => {
                let help =
                    "add `device = \"cartesian-bench\"`, or the path of a device file, at the top";
                let message = "a hand needs a device to hold";
                return Err(document.flaw(section.span(), message, "no device", Some(help)));
            }
            (None, _) => None,
        };
        if let (Some(section), Some(device)) = (&file.hand, &device) {
            warnings.extend(beyond_device(document, section.get_ref(), device));
        }
        let edges = (&mesh, hand.as_ref());
        let tools = read_tools(document, &file.tool, edges, (&mut warnings, &mut notes))?;
        warnings.extend(units::of_tools(document, &file.tool, &tools, &mesh));
        warnings.extend(units::of_lengths(document, &file));
        warnings.extend(units::of_places(document, &file, &mesh));
        warnings.extend(units::of_ways(document, &file));
        warnings.extend(units::of_loads(document, &file, &mesh));
        let moduli = || {
            let regions = file.region.iter().map(Spanned::get_ref);
            std::iter::once(&file.tissue.youngs_modulus_pa)
                .chain(regions.map(|region| &region.youngs_modulus_pa))
        };
        let pressing = hand.as_ref().zip(device.as_ref());
        let pressing =
            pressing.map(|(hand, device)| (hand, f64::from(device.description.max_force_n)));
        let is_stiff = moduli().any(|modulus| *modulus.get_ref() > units::STIFF_PA);
        let press = is_stiff.then(|| units::Press::of(&mesh, &tools, pressing));
        let press = press.flatten();
        warnings.extend(
            moduli().filter_map(|modulus| {
                units::of_stiffness(document, modulus, &tools, press.as_ref())
            }),
        );
        warnings.extend(moduli().filter_map(|modulus| units::of_softness(document, modulus)));
        let hands = (&tools[..], &file.tool[..]);
        let mut needles = read_needles(document, &file.needle, &tools, &mesh)?;
        let threads = read_threads(document, &file.thread, &needles, &tools)?;
        let jaws = read_jaws(document, &file.jaws, &tools, (&needles, &threads))?;
        // Where tissues touch and there are no needles, nothing else may be in the console's grip.
        if file.tissue_contact.is_empty() || !needles.is_empty() {
            warnings.extend(idle_grips(document, hands, (&needles, &threads), &jaws));
        }
        let sections = (&file.needle[..], &file.thread[..]);
        let parts = (&needles[..], &threads[..]);
        warnings.extend(out_of_reach(
            document,
            sections,
            parts,
            &tools,
            hand.as_ref(),
        ));
        let touching = read_touching(document, &file.tissue_contact, &mesh)?;
        let bodies = (&threads[..], &needles[..], &tools[..]);
        let (body_contacts, body_pairs) = read_body_contacts(document, &file.body_contact, bodies)?;
        warnings.extend(idle_pairs(document, &file.body_contact, &needles));
        let needle_tissue = read_needle_tissue(document, &file, &of_cell, &mut warnings)?;
        let added = added.into_iter().enumerate();
        let added = added.map(|(index, (span, section))| {
            let label = "in this section";
            section
                .build(index, &mesh)
                .map_err(|message| document.flaw(span, message, label, None))
        });
        let added = added.collect::<Result<_, _>>()?;
        let handles = file
            .handle
            .iter()
            .map(|h| read_handle(document, &mesh, &fixed, h));
        let handles = handles.collect::<Result<_, _>>()?;
        let mut forces = Vec::new();
        for load in &file.load {
            forces.extend(read_load(document, &mesh, load)?);
        }
        let densities = read_densities(document, &file, &mut warnings)?;
        let gravity = read_gravity(
            document,
            &file,
            &mesh,
            &of_cell,
            &densities,
            &fixed,
            &mut warnings,
        )?;
        weigh_needles(
            document,
            &file,
            gravity.as_ref(),
            &mut needles,
            &mut warnings,
        )?;
        let density_kg_per_m3 = densities.first().copied().flatten();
        let mut scene = Scene {
            name: file.name.clone().unwrap_or_else(|| name.to_owned()),
            seconds: read_seconds(document, &file)?,
            solve_at_s: read_solve_at(document, &file)?,
            mesh,
            tissue: read_tissue(document, &file.tissue)?,
            materials,
            density_kg_per_m3: density_kg_per_m3.unwrap_or(DENSITY_KG_PER_M3),
            relaxation: read_relaxation(document, &file.tissue)?,
            gravity,
            settle: true,
            regions,
            fixed,
            fixed_by,
            tools,
            needles,
            needle_tissue,
            threads,
            jaws,
            touching,
            body_contacts,
            body_pairs,
            added,
            needle_solver: read_needle_solver(document, &file)?,
            places: places(document, &file),
            loads: Loads {
                forces,
                handles,
                ..Loads::default()
            },
            handle_names: file.handle.iter().map(|h| h.name.clone()).collect(),
            device,
            hand,
            host: read_host(document, &file)?,
            warnings,
            notes,
            mesh_notes,
        };
        let (settle, warning) = read_settle(document, file.settle.as_ref(), &scene)?;
        scene.settle = settle;
        scene.warnings.extend(warning);
        Ok(scene)
    }
}

/// Places for errors that building the solver finds.
fn places(document: &Document, file: &SceneFile) -> Places {
    let note = |span, label: &str, help: Option<&str>| {
        let message = String::new();
        document.note(Severity::Error, span, message, label.to_owned(), help)
    };
    let place = |span, label: &str, help: &str| note(span, label, Some(help));
    let part = |part, span| (part, note(span, "in this section", None));
    let id = |id: &Option<Spanned<u8>>, index: usize| {
        id.as_ref().map_or(index as u8, |id| *id.get_ref())
    };
    let tools = file.tool.iter().enumerate();
    let tools =
        tools.map(|(index, said)| part(Part::Tool(id(&said.get_ref().id, index)), said.span()));
    let needles = file.needle.iter().enumerate();
    let needles =
        needles.map(|(index, said)| part(Part::Needle(id(&said.get_ref().id, index)), said.span()));
    let threads = file.thread.iter().enumerate();
    let threads =
        threads.map(|(index, said)| part(Part::Thread(id(&said.get_ref().id, index)), said.span()));
    let handles = file.handle.iter().enumerate();
    let handles = handles.map(|(index, said)| part(Part::Handle(index), said.vertices.span()));
    let touching = file.tissue_contact.iter().enumerate();
    let touching = touching.map(|(index, said)| part(Part::Touch(index), said.span()));
    let pairs = file.body_contact.iter().enumerate();
    let pairs = pairs.map(|(index, said)| part(Part::Pair(index), said.span()));
    let bodies = tools.chain(needles).chain(threads);
    let parts = bodies.chain(handles).chain(touching).chain(pairs).collect();
    let load = file.load.first().map(|load| load.total_force_n.span());
    let handle = file.handle.first();
    let handle = || handle.map(|handle| handle.target_displacement_m.span());
    let help = "make it smaller (forces are in N, lengths in m), the tissue stiffer, or hold more of it by `[[fixed]]`";
    let help_of_mesh = "see that `[[fixed]]` holds a part of every connected piece: planes and boxes are in metres";
    Places {
        acting: load
            .or_else(handle)
            .map(|span| place(span, "acts on the tissue", help)),
        mesh: place(file.mesh.span(), "this mesh", help_of_mesh),
        tissue: note(file.tissue.youngs_modulus_pa.span(), "this tissue", None),
        parts,
    }
}

fn read_seconds(document: &Document, file: &SceneFile) -> Result<f64, SceneError> {
    let Some(value) = &file.seconds else {
        return Ok(SECONDS);
    };
    let help = "a session lasts at most a day";
    document.number(
        "seconds",
        value,
        "more than 0 and at most 86400",
        |s| s > 0.0 && s <= LONGEST_S,
        help,
    )
}

fn read_solve_at(document: &Document, file: &SceneFile) -> Result<Option<f64>, SceneError> {
    let Some(value) = &file.solve_at_s else {
        return Ok(None);
    };
    let mut points = file.tool.iter().flat_map(|tool| &tool.get_ref().way_point);
    let none_goes = !points.any(|point| point.get_ref().position_m.is_some());
    let nothing = file.needle.is_empty() && file.tissue_contact.is_empty();
    if nothing && file.jaws.is_empty() && none_goes {
        let message = "a time to solve at in a scene where nothing depends on the way there";
        let help = "`sutura solve` follows scripts for needles, jaws, touching tissues and tools on ways of their own only: add a `[[needle]]`, or leave this key out";
        return Err(document.flaw(value.span(), message, "no needle", Some(help)));
    }
    let help = "seconds since the session begins";
    let rule = "from 0 to 86400";
    let sound = |s| (0.0..=LONGEST_S).contains(&s);
    document
        .number("solve_at_s", value, rule, sound, help)
        .map(Some)
}

/// What `[host]` says of the rate \[Hz\].
pub(super) fn read_host_hz(document: &Document) -> Result<f64, SceneError> {
    let (file, _) = added::read(document)?;
    let host = read_host(document, &file)?;
    Ok(host.host_hz)
}

fn read_host(document: &Document, file: &SceneFile) -> Result<HostSettings, SceneError> {
    let host_hz = match &file.host.host_hz {
        Some(value) => document.number(
            "host_hz",
            value,
            "from 1 to 1000",
            |hz| (1.0..=1000.0).contains(&hz),
            "the console asks for nothing faster than its own 1000 Hz",
        )?,
        None => HOST_HZ,
    };
    let horizon_us = match &file.host.horizon_ms {
        Some(value) => Some(document.number(
            "horizon_ms",
            value,
            "more than 0 and at most 150",
            |ms| ms > 0.0 && ms <= HORIZON_CAP_MS,
            "two or three host periods; every console caps it at 150 ms",
        )?),
        None => None,
    }
    .map(|ms| (ms * 1e3) as u32);
    Ok(HostSettings {
        host_hz,
        horizon_us,
    })
}

/// The mesh, and what its reader says of its file.
fn read_mesh(
    document: &Document,
    section: &Spanned<MeshSection>,
) -> Result<(TetMesh, Vec<Flaw>), SceneError> {
    let without_notes = |mesh| (mesh, Vec::new());
    match section.get_ref() {
        MeshSection {
            file: Some(file),
            scale_to_m: Some(scale),
            region_array,
            slab: None,
            part,
        } if part.is_empty() => {
            let help = "metres per unit of the mesh file: 0.001 for a mesh in millimetres";
            let scale = document.number("scale_to_m", scale, "positive", |s| s > 0.0, help)?;
            let path = document.resolve(file.get_ref());
            let array = region_array.as_ref().map(|name| name.get_ref().as_str());
            let raw = mesh::read_raw_mesh_with(&path, scale, array, |path| {
                document.file(path, mesh::MOST_BYTES)
            });
            let checked = raw.and_then(|mut raw| {
                let notes = std::mem::take(&mut raw.notes);
                Ok((raw.check()?, notes))
            });
            let (mesh, notes) = checked.map_err(|error| {
                if let (MeshError::NoCellArray { .. }, Some(name)) = (&error, region_array) {
                    let message = format!("the mesh {}: {error}", path.display());
                    let help = "cell arrays of .vtk and .vtu files have names; `sutura mesh info` lists those that are not used";
                    return document.flaw(name.span(), message, "no such cell array", Some(help));
                }
                let (message, help) = match error {
                    MeshError::Unreadable { file, reason } => (
                        format!("cannot read the mesh {file}: {reason}"),
                        "the path is relative to the scene file",
                    ),
                    error => (
                        format!("the mesh {} cannot be used: {error}", path.display()),
                        "elements and nodes are named by the number in that file, and by their place in it from 0; `sutura mesh info` says more",
                    ),
                };
                document.flaw(file.span(), message, "this file", Some(help))
            })?;
            let note = |said: String| {
                let message = format!("the mesh {}: {said}", path.display());
                document.note(Severity::Advice, file.span(), message, String::new(), None)
            };
            Ok((mesh, notes.into_iter().map(note).collect()))
        }
        MeshSection {
            file: None,
            scale_to_m: None,
            region_array: None,
            slab: Some(slab),
            part,
        } if part.is_empty() => read_slab(document, slab).map(without_notes),
        MeshSection {
            file: None,
            scale_to_m: None,
            region_array: None,
            slab: None,
            part,
        } if !part.is_empty() => read_parts(document, part).map(without_notes),
        _ => {
            let help = "give either `file = \"x.msh\"` with `scale_to_m`, or a `[mesh.slab]` section, or `[[mesh.part]]`s";
            let message = "the mesh comes from one place";
            Err(document.flaw(section.span(), message, "file, slab or parts", Some(help)))
        }
    }
}

/// Share of the stress that fades, and the time in which it does \[s\].
fn read_relaxation(
    document: &Document,
    section: &TissueSection,
) -> Result<Option<(f64, f64)>, SceneError> {
    let Some(relaxation) = &section.relaxation else {
        return Ok(None);
    };
    if section.model != TissueModel::EnergyBalanceNeoHookean {
        let message = format!(
            "the stress of {} tissue does not fade",
            section.model.word()
        );
        let help = "give `model = \"energy-balance-neo-hookean\"`, or leave `relaxation` out";
        return Err(document.flaw(relaxation.span(), message, "of another model", Some(help)));
    }
    let RelaxationSection { share, time_s } = relaxation.get_ref();
    let share = document.number(
        "share",
        share,
        "more than 0 and less than 1",
        |share| share > 0.0 && share < 1.0,
        "0.5: half of the stress fades; what does not fade holds the tissue together",
    )?;
    let time_s = document.number(
        "time_s",
        time_s,
        "from 0.001 to 10000",
        |time_s| (1e-3..=1e4).contains(&time_s),
        "soft tissue takes 0.1 to 100 s",
    )?;
    Ok(Some((share, time_s)))
}

fn read_tissue(document: &Document, section: &TissueSection) -> Result<Tissue, SceneError> {
    let model = section.model;
    let by_name = !matches!(
        model,
        TissueModel::Linear | TissueModel::Corotational | TissueModel::Auto
    );
    if let (Some(setting), false) = (&section.setting, by_name) {
        let message = format!("{} tissue has no settings by name", model.word());
        let help =
            "leave `setting` out; `[tissue.corotational]` has the settings of corotational tissue";
        return Err(document.flaw(setting.span(), message, "no such setting", Some(help)));
    }
    let settings = match (model, &section.corotational) {
        (TissueModel::Linear, None) => return Ok(Tissue::Linear),
        (TissueModel::Auto, None) => return Ok(Tissue::Auto),
        (TissueModel::Corotational, None) => {
            return Ok(Tissue::Corotational(Corotational::default()));
        }
        (TissueModel::Corotational, Some(settings)) => settings.get_ref(),
        (_, Some(settings)) => {
            let message = "settings for a model that this tissue does not have";
            let help = "add `model = \"corotational\"` to `[tissue]`, or leave this section out";
            let label = format!("the model is {}", model.word());
            return Err(document.flaw(settings.span(), message, label, Some(help)));
        }
        (_, None) => {
            let setting = section.setting.as_ref();
            let name = setting.map(|setting| setting.get_ref().as_str());
            let found = Registered::new(model.word(), name);
            return found.map(Tissue::Registered).map_err(|message| {
                let span = setting.map_or(0..0, Spanned::span);
                document.flaw(span, message, "no such setting", None)
            });
        }
    };
    let refactor_rotation_deg = match &settings.refactor_rotation_deg {
        Some(value) => Some(document.number(
            "refactor_rotation_deg",
            value,
            "more than 0 and at most 90",
            |degrees| degrees > 0.0 && degrees <= 90.0,
            "smaller follows large rotations better and costs more factorisations",
        )?),
        None => None,
    };
    let one_or_more = |key, value: &Option<Spanned<u32>>, help| match value {
        Some(zero) if *zero.get_ref() == 0 => {
            let message = format!("{key} = 0: must be 1 or more");
            Err(document.flaw(zero.span(), message, "must be 1 or more", Some(help)))
        }
        value => Ok(value.as_ref().map(|number| *number.get_ref())),
    };
    let refactor_every = one_or_more(
        "refactor_every",
        &settings.refactor_every,
        "1 factors in every pass of every step; leave the key out to go by rotation alone",
    )?;
    let passes = one_or_more(
        "passes",
        &settings.passes,
        "1 suits sessions: what a step leaves, the next one answers",
    )?;
    let tolerance = match &settings.tolerance {
        Some(value) => Some(document.number(
            "tolerance",
            value,
            "more than 0 and below 1",
            |share| share > 0.0 && share < 1.0,
            "a share of the forces on the tissue: 0.001 is far below what fingers tell apart",
        )?),
        None => None,
    };
    Ok(Tissue::Corotational(Corotational {
        refactor_rotation_deg,
        refactor_every,
        passes,
        tolerance,
        cg_iterations: settings.cg_iterations.as_ref().map(|n| *n.get_ref()),
    }))
}

fn read_handle(
    document: &Document,
    mesh: &TetMesh,
    fixed: &[u32],
    section: &HandleSection,
) -> Result<Handle, SceneError> {
    let (vertices, weights) = (&section.vertices, &section.barycentric);
    check_nodes(document, mesh, vertices)?;
    let nodes = vertices.get_ref();
    let flaw = |span, message: String, label: &str, help: &str| {
        Err(document.flaw(span, message, label, Some(help)))
    };
    if nodes.is_empty() {
        let help =
            "a handle is a point of the tissue: name the 1 to 4 nodes of the face or cell it is in";
        return flaw(
            vertices.span(),
            "a handle without vertices".to_owned(),
            "empty",
            help,
        );
    }
    let repeated = (1..nodes.len()).find(|i| nodes[..*i].contains(&nodes[*i]));
    if nodes.len() > 4 || repeated.is_some() {
        let message = "a handle has 1 to 4 different vertices".to_owned();
        let help = "they are the nodes of one face or cell";
        return flaw(vertices.span(), message, "not a face or cell", help);
    }
    if weights.get_ref().len() != nodes.len() {
        let message = format!(
            "{} weights for {} vertices",
            weights.get_ref().len(),
            nodes.len()
        );
        return flaw(
            weights.span(),
            message,
            "as many as vertices",
            "one weight for each vertex",
        );
    }
    let sum: f64 = weights.get_ref().iter().sum();
    let negative = weights.get_ref().iter().any(|w| *w < 0.0);
    // Coordinates written with seven digits still pass.
    let sums_to_one = (sum - 1.0).abs() <= 1e-6;
    if negative || !sums_to_one {
        let message = format!("barycentric coordinates must be 0 or more and sum to 1, not {sum}");
        let help =
            "they weigh the vertices: [1.0] for a node, [0.5, 0.5] for the middle of an edge";
        return flaw(weights.span(), message, "not a point inside", help);
    }
    if nodes.iter().all(|n| fixed.binary_search(n).is_ok()) {
        let message = "a handle on fixed nodes cannot move".to_owned();
        let help = "take a handle elsewhere, or let these nodes go in `[[fixed]]`";
        return flaw(vertices.span(), message, "all fixed", help);
    }
    let anchor = Anchor {
        vertices: nodes.clone(),
        weights: weights.get_ref().clone(),
    };
    let target = document.finite("target_displacement_m", &section.target_displacement_m)?;
    Ok(Handle {
        anchor,
        target_displacement_m: target,
    })
}

fn read_load(
    document: &Document,
    mesh: &TetMesh,
    section: &LoadSection,
) -> Result<Vec<NodeLoad>, SceneError> {
    let nodes = select(document, mesh, &section.on)?;
    let total = document.finite("total_force_n", &section.total_force_n)?;
    let force_n = total.map(|f| f / nodes.len() as f64);
    Ok(nodes
        .into_iter()
        .map(|node| NodeLoad { node, force_n })
        .collect())
}
