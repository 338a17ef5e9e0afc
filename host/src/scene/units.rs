//! Sizes, stiffnesses and places that suggest another unit than the one that a key asks for.
//!
//! Entry points: [`unlikely_size`], [`of_mesh`], [`of_tools`], [`of_lengths`], [`of_places`], [`of_ways`], [`of_loads`], [`of_stiffness`], [`of_softness`], [`of_encoders`].
//! Millimetres for metres are off by 1000, and so are kPa for Pa: that is what a hint proposes, where it helps.

use super::Tool;
use super::document::{Document, Flaw};
use super::hand::PEAK_SPEED;
use super::tools::depth_m;
use super::way;
use crate::mesh::{TetMesh, mean_ratio};
use crate::tool::Shape;
use nalgebra::Vector3;
use std::ops::Range;
use sutura_scene_file::device::DeviceFile;
use sutura_scene_file::scene::{MeshSection, SceneFile, ToolSection};
use sutura_shared::wire::message::HandScript;
use sutura_shared::wire::validate::{MAX_TANGENT, MAX_WRENCH};
use toml::Spanned;

/// Largest and smallest size of a body that somebody sews or feels \[m\]: a person, a vessel.
const SIZES_M: [f64; 2] = [2.0, 0.002];

/// What a size is off by if it is beyond [`SIZES_M`], and would not be with that factor: 0.001 or 1000; none for a likely size.
/// `Some(None)`: beyond them, and no factor helps.
fn likely_scale(size_m: f64) -> Option<Option<f64>> {
    let [most, least] = SIZES_M;
    // Of a mesh of just that size the last bit may be too much.
    let is_likely = |size: f64| (least * (1.0 - 1e-9)..=most * (1.0 + 1e-9)).contains(&size);
    if is_likely(size_m) || size_m.is_nan() {
        return None;
    }
    Some(
        [0.001, 1000.0]
            .into_iter()
            .find(|factor| is_likely(size_m * factor)),
    )
}

/// What is unlikely of a body of this size \[m\], and what to do, in words; none for a likely one. `key`: what scales it.
pub fn unlikely_size(size_m: f64, key: &str) -> Option<(String, String)> {
    let factor = likely_scale(size_m)?;
    let [most, least] = SIZES_M;
    let (limit, than) = if size_m > most {
        (most, "larger than")
    } else {
        (least, "smaller than")
    };
    let message = format!(
        "the body is {} in size, {than} {}",
        length(size_m),
        length(limit)
    );
    let help = match factor {
        Some(factor) => format!(
            "lengths are in metres: with {key} times {factor} it is {}",
            length(size_m * factor)
        ),
        None => format!("lengths are in metres: see {key}"),
    };
    Some((message, help))
}

/// A length as people say it.
pub(super) fn length(length_m: f64) -> String {
    match length_m {
        m if !(1e-6..1e4).contains(&m) => format!("{m:.1e} m"),
        m if m >= 1.0 => format!("{m:.1} m"),
        m if m >= 1e-3 => format!("{:.1} mm", 1e3 * m),
        m => format!("{:.1} um", 1e6 * m),
    }
}

/// Lowest and highest corner of the box around a mesh \[m\], (3) each.
fn bounds(mesh: &TetMesh) -> [[f64; 3]; 2] {
    let mut bounds = [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]];
    for point in mesh.points_m() {
        for (axis, x) in point.iter().enumerate() {
            bounds[0][axis] = bounds[0][axis].min(*x);
            bounds[1][axis] = bounds[1][axis].max(*x);
        }
    }
    bounds
}

/// Sides of the box around a mesh \[m\], (3).
fn sides_m(mesh: &TetMesh) -> [f64; 3] {
    let [low, high] = bounds(mesh);
    [0, 1, 2].map(|axis| high[axis] - low[axis])
}

/// Largest side of the box around a mesh \[m\].
pub(super) fn size_m(mesh: &TetMesh) -> f64 {
    sides_m(mesh).into_iter().fold(0.0, f64::max)
}

/// Thinnest body that is meant in metres \[m\]: skin and the walls of vessels are thicker.
const THINNEST_M: f64 = 1e-4;
/// Mean ratio (Liu and Joe 1994) of a cell a hundred times as wide as thick: solves of flatter ones are slow and inexact.
const FLATTEST: f64 = 0.058;
/// A mesh with a larger share of such cells is warned of.
const FEW_FLAT: f64 = 0.01;

/// Warnings of a mesh of an unlikely size or thickness, at what scales it, and of cells that are all but flat.
pub(super) fn of_mesh(
    document: &Document,
    section: &Spanned<MeshSection>,
    mesh: &TetMesh,
) -> Vec<Flaw> {
    let scale = section.get_ref().scale_to_m.as_ref();
    let slab = section.get_ref().slab.as_ref();
    let (key, at) = match (scale, slab) {
        (Some(scale), _) => ("`scale_to_m`", scale.span()),
        (None, Some(slab)) => ("`size_m`", slab.get_ref().size_m.span()),
        (None, None) => ("`size_m`", section.span()),
    };
    let mut warned = Vec::new();
    if let Some((message, help)) = unlikely_size(size_m(mesh), key) {
        warned.push(document.warning(at.clone(), &message, "hardly metres", &help));
    }
    let thin_m = sides_m(mesh).into_iter().fold(f64::INFINITY, f64::min);
    if thin_m < THINNEST_M {
        let message = format!(
            "the body is {} thick, thinner than {}",
            length(thin_m),
            length(THINNEST_M)
        );
        let help = format!(
            "lengths are in metres: times 1000 it is {}; see {key}",
            length(1e3 * thin_m)
        );
        warned.push(document.warning(at.clone(), &message, "hardly metres", &help));
    }
    let corners = |cell: &[u32; 4]| cell.map(|node| mesh.points_m()[node as usize].into());
    let flat = mesh
        .cells()
        .iter()
        .filter(|cell| mean_ratio(&corners(cell)) < FLATTEST);
    let (flat, cells) = (flat.count(), mesh.cells().len());
    if flat as f64 > FEW_FLAT * cells as f64 {
        let message = format!("{flat} of {cells} cells are over a hundred times as wide as thick");
        let help = "steps take long and forces are not to be relied on: take fewer `divisions` across what is thin and more along it, or a mesh with better cells (`sutura mesh info` has their quality)";
        warned.push(document.warning(at, &message, "flat cells", help));
    }
    warned
}

/// A warning for each tool whose radius is larger than the body which it touches. Balls somewhat larger than what they press on are
/// in use.
pub(super) fn of_tools(
    document: &Document,
    sections: &[Spanned<ToolSection>],
    tools: &[Tool],
    mesh: &TetMesh,
) -> Vec<Flaw> {
    let body_m = size_m(mesh);
    let large = tools.iter().zip(sections).filter_map(|(tool, section)| {
        let radius_m = tool.shape.radius_m();
        (radius_m > body_m).then(|| {
            let message = format!(
                "tool {} has a radius of {}, larger than the body of {}",
                tool.id,
                length(radius_m),
                length(body_m)
            );
            let help = match 1e-3 * radius_m < body_m {
                true => format!(
                    "lengths are in metres: times 0.001 it is {}",
                    length(1e-3 * radius_m)
                ),
                false => "lengths are in metres".to_owned(),
            };
            document.warning(way::place(section), &message, "larger than the body", &help)
        })
    });
    large.collect()
}

/// Range of a length \[m\]; a value outside is hardly meant in metres.
struct Limits {
    what: &'static str,
    least_m: f64,
    most_m: f64,
}

impl Limits {
    const fn new(what: &'static str, least_m: f64, most_m: f64) -> Self {
        Self {
            what,
            least_m,
            most_m,
        }
    }

    fn has(&self, length_m: f64) -> bool {
        // The last bit of a length of just that size may be too much.
        let [least, most] = [self.least_m * (1.0 - 1e-9), self.most_m * (1.0 + 1e-9)];
        (least..=most).contains(&length_m)
    }

    /// Returns a warning and the next step for an unlikely value; none for a likely one.
    fn hint(&self, key: &str, length_m: f64) -> Option<(String, String)> {
        if self.has(length_m) || !length_m.is_finite() {
            return None;
        }
        let (limit_m, than) = match length_m > self.most_m {
            true => (self.most_m, "larger than"),
            false => (self.least_m, "smaller than"),
        };
        let message = format!(
            "`{key}`: {} {}, {than} {}",
            self.what,
            length(length_m),
            length(limit_m)
        );
        let factors = [0.001, 1000.0];
        let help = match factors.iter().find(|factor| self.has(length_m * **factor)) {
            Some(factor) => format!(
                "lengths are in metres: times {factor} it is {}",
                length(length_m * factor)
            ),
            None => "lengths are in metres".to_owned(),
        };
        Some((message, help))
    }
}

/// Along a tool, a needle, a thread or pads, and how far a grip reaches: none is longer than a person.
const LONG: Limits = Limits::new("a length of", 1e-4, SIZES_M[0]);
/// Radius of a bar: from a wire to an arm.
const BAR_RADIUS: Limits = Limits::new("a bar with a radius of", 5e-5, 0.05);
/// Radius of an arc: from the smallest vascular needle on.
const ARC_RADIUS: Limits = Limits::new("a circle with a radius of", 1e-4, SIZES_M[0]);
/// From the needles of surgery under a microscope to cannulas.
const NEEDLE: Limits = Limits::new("a needle with a diameter of", 1e-5, 5e-3);
/// From the finest sutures, 12-0, to tapes.
const THREAD: Limits = Limits::new("a thread with a diameter of", 1e-6, 5e-3);
/// From the grip to what it carries.
const OFFSET: Limits = Limits::new("a way of", 0.0, SIZES_M[0]);

/// A warning for each length of what tools, needles, threads and jaws are that is hardly meant in metres.
pub(super) fn of_lengths(document: &Document, file: &SceneFile) -> Vec<Flaw> {
    let mut warned = Vec::new();
    let mut look = |limits: &Limits, key: &str, span: Range<usize>, length_m: f64| {
        let hint = limits.hint(key, length_m).into_iter();
        let flaw = |(message, help): (String, String)| {
            document.warning(span.clone(), &message, "hardly metres", &help)
        };
        warned.extend(hint.map(flaw));
    };
    let mut number = |limits: &Limits, key: &str, said: Option<&Spanned<f64>>| {
        // Zero is a value of its own for these keys, not a size.
        if let Some(said) = said.filter(|said| *said.get_ref() != 0.0) {
            look(limits, key, said.span(), *said.get_ref());
        }
    };
    for tool in file.tool.iter().map(Spanned::get_ref) {
        number(&LONG, "length_m", tool.length_m.as_ref());
        number(&LONG, "reach_m", tool.reach_m.as_ref());
        if let Some(body) = tool.body.as_ref().map(Spanned::get_ref) {
            number(&BAR_RADIUS, "radius_m", Some(&body.radius_m));
            number(&LONG, "length_m", Some(&body.length_m));
        }
    }
    for needle in file.needle.iter().map(Spanned::get_ref) {
        number(&LONG, "length_m", needle.length_m.as_ref());
        number(&ARC_RADIUS, "radius_m", needle.radius_m.as_ref());
        number(&NEEDLE, "thickness_m", Some(&needle.thickness_m));
        let segments = needle.segments.iter().flat_map(Spanned::get_ref);
        for segment in segments {
            number(&LONG, "length_m", Some(&segment.length_m));
            number(&ARC_RADIUS, "radius_m", segment.radius_m.as_ref());
        }
    }
    for thread in file.thread.iter().map(Spanned::get_ref) {
        number(&LONG, "length_m", Some(&thread.length_m));
        number(&THREAD, "thickness_m", thread.thickness_m.as_ref());
    }
    for jaws in file.jaws.iter().map(Spanned::get_ref) {
        number(&LONG, "length_m", jaws.length_m.as_ref());
        number(&LONG, "width_m", jaws.width_m.as_ref());
    }
    let tools = || file.tool.iter().map(Spanned::get_ref);
    let bodies = tools().filter_map(|tool| tool.body.as_ref());
    let offsets = tools()
        .map(|tool| &tool.offset_m)
        .chain(bodies.map(|body| &body.get_ref().offset_m))
        .chain(file.jaws.iter().map(|jaws| &jaws.get_ref().offset_m));
    for said in offsets.flatten() {
        let far_m = Vector3::from(*said.get_ref()).norm();
        look(&OFFSET, "offset_m", said.span(), far_m);
    }
    for said in tools().filter_map(|tool| tool.size_m.as_ref()) {
        let unlikely = |size_m: &&f64| !LONG.has(**size_m);
        if let Some(size_m) = said.get_ref().iter().find(unlikely) {
            look(&LONG, "size_m", said.span(), *size_m);
        }
    }
    warned
}

/// Farthest from the tissue that anything happens \[m\]: as far as the largest body is long.
const FARTHEST_M: f64 = SIZES_M[0];

/// A warning for each place of a tool, a needle, a thread or the hand that is far from the tissue: one a section.
pub(super) fn of_places(document: &Document, file: &SceneFile, mesh: &TetMesh) -> Vec<Flaw> {
    let [low, high] = bounds(mesh);
    let far_m = |place: &[f64; 3]| {
        let away = [0, 1, 2].map(|axis| {
            let x = place[axis];
            (low[axis] - x).max(x - high[axis]).max(0.0)
        });
        // Without an overflow.
        let most = away.into_iter().fold(0.0, f64::max);
        match most > 0.0 && most.is_finite() {
            true => most * (Vector3::from(away) / most).norm(),
            false => most,
        }
    };
    let mut warned = Vec::new();
    let mut look = |key: &str, mut places: &mut dyn Iterator<Item = &Spanned<[f64; 3]>>| {
        let far = |place: &&Spanned<[f64; 3]>| {
            let far_m = far_m(place.get_ref());
            far_m > FARTHEST_M
        };
        let Some(place) = Iterator::find(&mut places, far) else {
            return;
        };
        let message = format!(
            "`{key}`: {} from the tissue, farther than {}",
            length(far_m(place.get_ref())),
            length(FARTHEST_M)
        );
        let nearer = place.get_ref().map(|along| 1e-3 * along);
        let help = match far_m(&nearer) <= FARTHEST_M {
            true => format!(
                "lengths are in metres: times 0.001 it is ({}, {}, {}) m",
                nearer[0], nearer[1], nearer[2]
            ),
            false => "lengths are in metres".to_owned(),
        };
        warned.push(document.warning(place.span(), &message, "far from the tissue", &help));
    };
    for tool in file.tool.iter().map(Spanned::get_ref) {
        let points = tool.way_point.iter();
        let points = points.filter_map(|point| point.get_ref().position_m.as_ref());
        look("position_m", &mut tool.position_m.iter().chain(points));
    }
    for needle in file.needle.iter().map(Spanned::get_ref) {
        look("end_m", &mut std::iter::once(&needle.end_m));
    }
    for thread in file.thread.iter().map(Spanned::get_ref) {
        let holds = thread.hold.iter().map(|hold| &hold.get_ref().at_m);
        let cuts = thread.cut.iter().map(|cut| &cut.get_ref().at_m);
        look("at_m", &mut holds.chain(cuts).flatten());
    }
    if let Some(hand) = file.hand.as_ref().map(Spanned::get_ref) {
        let points = hand.way_point.get_ref().iter();
        look("position_m", &mut points.map(|point| &point.position_m));
    }
    let body_m = size_m(mesh);
    for handle in &file.handle {
        let said = &handle.target_displacement_m;
        let way_m = Vector3::from(*said.get_ref()).norm();
        if way_m > body_m {
            let message = format!(
                "`target_displacement_m`: {}, farther than the body is large, {}",
                length(way_m),
                length(body_m)
            );
            let help = match 1e-3 * way_m <= body_m {
                true => format!(
                    "lengths are in metres: times 0.001 it is {}",
                    length(1e-3 * way_m)
                ),
                false => "lengths are in metres".to_owned(),
            };
            warned.push(document.warning(said.span(), &message, "hardly metres", &help));
        }
    }
    warned
}

/// Fastest motion of a hand, and of a needle holder that it turns \[m/s, rad/s\]: beyond that a script is hardly meant.
const FASTEST: [f64; 2] = [2.0, 30.0];

/// A warning at the first way point of each tool's script that is reached faster than a hand moves.
pub(super) fn of_ways(document: &Document, file: &SceneFile) -> Vec<Flaw> {
    let tools = file.tool.iter().map(Spanned::get_ref);
    let fast = tools.filter_map(|tool| {
        let mut pairs = tool.way_point.windows(2);
        pairs.find_map(|pair| {
            let [from, to] = [0, 1].map(|index| pair[index].get_ref());
            let length_s = to.time_s.get_ref() - from.time_s.get_ref();
            let zero = [0.0; 3];
            let apart = |from: Option<&Spanned<[f64; 3]>>, to: Option<&Spanned<[f64; 3]>>| {
                let [from, to] = [from, to].map(|at| Vector3::from(*at.map_or(&zero, Spanned::get_ref)));
                from.metric_distance(&to)
            };
            let way_m = apart(from.position_m.as_ref(), to.position_m.as_ref());
            let turn_deg = apart(from.rotation_deg.as_ref(), to.rotation_deg.as_ref());
            let [most_m, most_rad] = FASTEST;
            let (at, how, needed_s) = if PEAK_SPEED * way_m > most_m * length_s {
                let how = format!("{} in {length_s} s, faster than {most_m} m/s", length(way_m));
                (to.position_m.as_ref()?, how, PEAK_SPEED * way_m / most_m)
            } else if PEAK_SPEED * turn_deg.to_radians() > most_rad * length_s {
                let turns = turn_deg / 360.0;
                let how = format!("{turns:.1} turns in {length_s} s, faster than {most_rad} rad/s");
                let needed_s = PEAK_SPEED * turn_deg.to_radians() / most_rad;
                (to.rotation_deg.as_ref()?, how, needed_s)
            } else {
                return None;
            };
            let message = format!("this way point is reached over {how} at the fastest");
            let help = format!(
                "no hand is as fast: give it {needed_s:.2} s, or a shorter way; lengths are in metres, turns in degrees"
            );
            Some(document.warning(at.span(), &message, "hardly meant", &help))
        })
    });
    fast.collect()
}

/// Largest step of an encoder at the grip \[m\]: coarser ones are felt as jumps of force, and are hardly meant.
const COARSEST_M: f64 = 1e-4;

/// A warning for each encoder of a device file whose step moves the grip by more than [`COARSEST_M`]. The step of a turning joint is that
/// of the stretched arm.
pub(super) fn of_encoders(document: &Document, file: &DeviceFile) -> Vec<Flaw> {
    let mut warned = Vec::new();
    let mut look = |joint: usize, key: &Encoder, said: &Spanned<f64>, lever_m: f64| {
        let step_m = lever_m / said.get_ref().abs();
        let is_likely = |step_m: f64| step_m <= COARSEST_M * (1.0 + 1e-9);
        if is_likely(step_m) {
            return;
        }
        let message = format!(
            "joint {joint}: {} = {}: a step of {}, larger than {}",
            key.name,
            short(*said.get_ref()),
            length(step_m),
            length(COARSEST_M)
        );
        let help = match is_likely(step_m / key.factor) {
            true => format!(
                "{} are asked for: times {} it is {}",
                key.unit,
                key.factor,
                length(step_m / key.factor)
            ),
            false => format!("{} are asked for", key.unit),
        };
        warned.push(document.warning(said.span(), &message, "a coarse encoder", &help));
    };
    if let Some(section) = file.cartesian.as_ref().map(Spanned::get_ref) {
        for (joint, stage) in section.joint.get_ref().iter().enumerate() {
            look(joint, &PER_METRE, &stage.counts_per_m, 1.0);
        }
    }
    if let Some(section) = file.serial_arm.as_ref().map(Spanned::get_ref) {
        let [upper_m, fore_m] = [&section.upper_m, &section.fore_m].map(|said| *said.get_ref());
        let levers_m = [upper_m + fore_m, upper_m + fore_m, fore_m];
        let joints = section.joint.get_ref().iter().zip(levers_m).enumerate();
        for (joint, (turning, lever_m)) in joints {
            look(joint, &PER_RADIAN, &turning.counts_per_rad, lever_m);
        }
    }
    warned
}

/// A number in the shortest form that says it.
fn short(value: f64) -> String {
    let (plain, scientific) = (format!("{value}"), format!("{value:e}"));
    if plain.len() > scientific.len() + 3 {
        scientific
    } else {
        plain
    }
}

/// The key of an encoder, its unit, and the factor from the unit that it is most easily mistaken for.
struct Encoder {
    name: &'static str,
    unit: &'static str,
    factor: f64,
}

const PER_METRE: Encoder = Encoder {
    name: "counts_per_m",
    unit: "counts per metre",
    factor: 1000.0,
};

const PER_RADIAN: Encoder = Encoder {
    name: "counts_per_rad",
    unit: "counts per radian",
    // Degrees in a radian, to a tenth.
    factor: 57.3,
};

/// A warning of a load that stretches tissue to more than twice its size: of force F, modulus E and size L, F / (E L^2) > 1.
pub(super) fn of_loads(document: &Document, file: &SceneFile, mesh: &TetMesh) -> Vec<Flaw> {
    let modulus_pa = *file.tissue.youngs_modulus_pa.get_ref();
    let body_m = size_m(mesh);
    let loads = file.load.iter().filter_map(|load| {
        let said = &load.total_force_n;
        let force_n = Vector3::from(*said.get_ref()).norm();
        let times = force_n / (modulus_pa * body_m * body_m);
        if times.is_nan() || times <= 1.0 {
            return None;
        }
        let message = format!(
            "`total_force_n`: {force_n:.4e} N, which stretches a body of {} and {modulus_pa:e} Pa by about {times:.1} of its size",
            length(body_m)
        );
        let help = "forces are in N, the modulus in Pa: make the load smaller, or the tissue stiffer";
        Some(document.warning(said.span(), &message, "more than the tissue bears", help))
    });
    loads.collect()
}

/// Young's moduli of the stiffest and the softest tissue \[Pa\]. Fat and brain have some hundred; softer tissue is not felt.
const SOFT_PA: [f64; 2] = [1e6, 100.0];

/// A warning of tissue that gives way to everything.
pub(super) fn of_softness(document: &Document, modulus: &Spanned<f64>) -> Option<Flaw> {
    let modulus_pa = *modulus.get_ref();
    let [most_pa, least_pa] = SOFT_PA;
    if modulus_pa >= least_pa || modulus_pa.is_nan() {
        return None;
    }
    let message = format!(
        "youngs_modulus_pa = {modulus_pa}: softer than {least_pa} Pa, and hardly felt at all"
    );
    let fits = |factor: &f64| (least_pa..=most_pa).contains(&(factor * modulus_pa));
    let help = match [1e3, 1e6].into_iter().find(fits) {
        Some(factor) => {
            let times_pa = factor * modulus_pa;
            let said = match times_pa >= 1e3 {
                true => format!("{} kPa", 1e-3 * times_pa),
                false => format!("{times_pa} Pa"),
            };
            format!("the modulus is in Pa: soft tissue has 1e3 to 1e6; times {factor} it is {said}")
        }
        None => "the modulus is in Pa: soft tissue has 1e3 to 1e6".to_owned(),
    };
    Some(document.warning(modulus.span(), &message, "too soft to be felt", &help))
}

/// Young's modulus of tendon \[Pa\]: no tissue that is sutured is stiffer.
const HARD_PA: f64 = 1e9;

/// A warning of tissue that is stiffer than any.
fn of_hardness(document: &Document, modulus: &Spanned<f64>) -> Option<Flaw> {
    let modulus_pa = *modulus.get_ref();
    if modulus_pa <= HARD_PA || modulus_pa.is_nan() {
        return None;
    }
    let message =
        format!("youngs_modulus_pa = {modulus_pa:e}: stiffer than {HARD_PA:e} Pa, as no tissue is");
    let help = "the modulus is in Pa: soft tissue has 1e3 to 1e6";
    Some(document.warning(modulus.span(), &message, "too stiff", help))
}

/// Softer tissue stays far below what a frame takes, whatever presses on it \[Pa\].
pub(super) const STIFF_PA: f64 = 1e5;
/// Plane modulus over Young's, of tissue that keeps its volume (Johnson 1985, 3.36).
const PLANE: f64 = 4.0 / 3.0;
/// Modulus of a layer that is pressed against what holds it, over Young's: it bulges beside the tool.
const LAYER: f64 = 2.0;

/// Driven tool, as far as the stiffness of what it presses on goes.
pub(super) struct Press {
    radius_m: f64,
    is_round: bool,
    /// From [`depth_m`].
    depth_m: f64,
    /// Smallest side of the tissue \[m\].
    layer_m: f64,
}

impl Press {
    /// Describes the driven tool; none without one that touches by its shape.
    pub fn of(mesh: &TetMesh, tools: &[Tool], hand: Option<(&HandScript, f64)>) -> Option<Self> {
        let tool = tools.iter().find(|tool| tool.driven)?;
        let radius_m = tool.shape.radius_m();
        let is_round = matches!(
            tool.shape.shape,
            Shape::Sphere { .. } | Shape::Capsule { .. }
        );
        let [low, high] = bounds(mesh);
        let sides = (0..3).map(|axis| high[axis] - low[axis]);
        (radius_m > 0.0).then(|| Self {
            radius_m,
            is_round,
            depth_m: hand.map_or(0.0, |hand| depth_m(mesh, tool, hand)),
            layer_m: sides.fold(f64::INFINITY, f64::min),
        })
    }

    /// Estimates the stiffness \[N/m\] and the largest force \[N\] over Young's modulus: a half-space under a punch or a ball, and a
    /// layer of the tissue's thickness.
    fn over_modulus(&self) -> [f64; 2] {
        let Self {
            radius_m,
            is_round,
            depth_m,
            layer_m,
        } = *self;
        let (contact_m, share) = match is_round {
            true => ((radius_m * depth_m).sqrt().min(radius_m), 2.0 / 3.0),
            false => (radius_m, 1.0),
        };
        let layer = LAYER * std::f64::consts::PI * contact_m.powi(2) / layer_m;
        let stiffness = 2.0 * PLANE * contact_m + layer;
        [stiffness, share * stiffness * depth_m]
    }
}

/// A warning of tissue on which a tool is stiffer, or presses harder, than a frame can say: a flat punch of radius a feels at least
/// `2 E a` (Johnson 1985, 3.36).
pub(super) fn of_stiffness(
    document: &Document,
    modulus: &Spanned<f64>,
    tools: &[Tool],
    press: Option<&Press>,
) -> Option<Flaw> {
    let [most, most_n] = [MAX_TANGENT, MAX_WRENCH].map(f64::from);
    let modulus_pa = *modulus.get_ref();
    let radius_m = tools
        .iter()
        .map(|tool| tool.shape.radius_m())
        .fold(0.0, f64::max);
    let [pressed, force] = press.map_or([0.0; 2], Press::over_modulus);
    let (at_rest, force_n) = (2.0 * modulus_pa * radius_m, force * modulus_pa);
    let stiffness = at_rest.max(pressed * modulus_pa);
    let radius_m = match press {
        Some(press) if at_rest <= most => press.radius_m,
        _ => radius_m,
    };
    let over = (stiffness / most).max(force_n / most_n);
    if over <= 1.0 || over.is_nan() {
        return of_hardness(document, modulus);
    }
    let (feels, takes) = match stiffness > most {
        true => (format!("{stiffness:.0e} N/m"), format!("{most:.0e} N/m")),
        false => (format!("{force_n:.0e} N"), format!("{most_n:.0e} N")),
    };
    let message = format!(
        "youngs_modulus_pa = {modulus_pa:e}: a tool of {} on it feels up to {feels}, and a frame takes {takes}",
        length(radius_m)
    );
    let help = match 1e-3 * over <= 1.0 {
        true => format!(
            "the modulus is in Pa: soft tissue has 1e3 to 1e6; times 0.001 it is {:e}",
            1e-3 * modulus_pa
        ),
        false => "the modulus is in Pa: soft tissue has 1e3 to 1e6".to_owned(),
    };
    Some(document.warning(modulus.span(), &message, "too stiff to be felt", &help))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::read;

    /// A ball that the hand presses by 4 mm more than it gives way, and a punch whose rounded face is all in contact: from 1.65e8 Pa,
    /// and between 1e8 and 2.5e8 Pa, a session's frames are beyond their range.
    #[test]
    fn tissue_too_stiff_for_a_frame_is_told() {
        let scene = include_str!("../../../scenes/palpation.toml");
        let ball = "radius_m = 0.014\n";
        let punch = "shape = \"flat-punch\"\nradius_m = 0.012\nfillet_m = 0.002\nlength_m = 0.03\n";
        for (tool, modulus_pa, takes) in [
            (ball, 5e7, None),
            (ball, 1.65e8, Some("e4 N, and a frame takes 1e4 N")),
            (ball, 2.5e8, Some("a frame takes 1e4 N")),
            (ball, 5e8, Some("a frame takes 1e7 N/m")),
            (punch, 5e7, None),
            (punch, 2.5e8, Some("a frame takes 1e7 N/m")),
        ] {
            let text = scene
                .replace(
                    "youngs_modulus_pa = 15e3",
                    &format!("youngs_modulus_pa = {modulus_pa:e}"),
                )
                .replace(ball, tool);
            let document = Document::embedded("palpation.toml", "".as_ref(), &text);
            let warnings = read(&document).expect("a good scene").warnings;
            let stiff = warnings
                .iter()
                .map(ToString::to_string)
                .find(|said| said.contains("a frame takes"));
            match takes {
                Some(takes) => {
                    let stiff = stiff.unwrap_or_else(|| panic!("{modulus_pa:e}: not told"));
                    assert!(stiff.contains(takes), "{stiff}");
                }
                None => assert_eq!(stiff, None),
            }
        }
    }

    #[test]
    fn sizes_beyond_the_limits_are_told_with_the_factor_that_mends_them() {
        for (size_m, factor) in [
            (2.0, None),
            (0.002, None),
            (150.0, Some(Some(0.001))),
            (1.5e-4, Some(Some(1000.0))),
            (2.5, Some(Some(0.001))),
            (1e5, Some(None)),
            (f64::NAN, None),
        ] {
            assert_eq!(likely_scale(size_m), factor, "{size_m}");
        }
        let (message, help) = unlikely_size(150.0, "`scale_to_m`").expect("too large");
        assert_eq!(message, "the body is 150.0 m in size, larger than 2.0 m");
        assert_eq!(
            help,
            "lengths are in metres: with `scale_to_m` times 0.001 it is 150.0 mm"
        );
    }
}
