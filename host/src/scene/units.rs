//! Sizes, stiffnesses and places that suggest another unit than the one that a key asks for.
//!
//! Entry points: [`unlikely_size`], [`of_mesh`], [`of_tools`], [`of_lengths`],
//! [`of_stiffness`]. Millimetres for metres are off by
//! 1000, and so are kPa for Pa: that is what a hint proposes, where it helps.

use super::Tool;
use super::document::{Document, Flaw};
use super::way;
use crate::mesh::TetMesh;
use sutura_scene_file::scene::{MeshSection, SceneFile, ToolSection};
use sutura_shared::wire::validate::MAX_TANGENT;
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
fn length(length_m: f64) -> String {
    match length_m {
        m if !(1e-6..1e4).contains(&m) => format!("{m:.1e} m"),
        m if m >= 1.0 => format!("{m:.1} m"),
        m if m >= 1e-3 => format!("{:.1} mm", 1e3 * m),
        m => format!("{:.1} um", 1e6 * m),
    }
}

/// Largest side of the box around a mesh \[m\].
pub(super) fn size_m(mesh: &TetMesh) -> f64 {
    let sides = (0..3).map(|axis| {
        let along = mesh.points_m().iter().map(|point| point[axis]);
        let (low, high) = along.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| {
            (low.min(x), high.max(x))
        });
        high - low
    });
    sides.fold(0.0, f64::max)
}

/// A warning of a mesh of an unlikely size, at what scales it.
pub(super) fn of_mesh(
    document: &Document,
    section: &Spanned<MeshSection>,
    mesh: &TetMesh,
) -> Option<Flaw> {
    let scale = section.get_ref().scale_to_m.as_ref();
    let (key, at) = match scale {
        Some(scale) => ("`scale_to_m`", scale.span()),
        None => ("`size_m`", section.span()),
    };
    let (message, help) = unlikely_size(size_m(mesh), key)?;
    Some(document.warning(at, &message, "hardly metres", &help))
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

/// A warning for each length of a tool, a needle or a thread beyond the largest body: none is longer than a person.
pub(super) fn of_lengths(document: &Document, file: &SceneFile) -> Vec<Flaw> {
    let tools = file.tool.iter().map(|section| &section.get_ref().length_m);
    let needles = file.needle.iter().map(Spanned::get_ref);
    let needles = needles.flat_map(|needle| [&needle.length_m, &needle.radius_m]);
    let threads = file
        .thread
        .iter()
        .map(|section| &section.get_ref().length_m);
    let lengths = tools.chain(needles).flatten().chain(threads);
    let [most, _] = SIZES_M;
    let long = lengths.filter(|length_m| *length_m.get_ref() > most);
    let warned = long.map(|length_m| {
        let long_m = *length_m.get_ref();
        let message = format!("{} long, larger than {}", length(long_m), length(most));
        let help = match 1e-3 * long_m <= most {
            true => format!(
                "lengths are in metres: times 0.001 it is {}",
                length(1e-3 * long_m)
            ),
            false => "lengths are in metres".to_owned(),
        };
        document.warning(length_m.span(), &message, "hardly metres", &help)
    });
    warned.collect()
}

/// A warning of tissue on which a tool is stiffer than a frame can say: a flat punch of radius a feels at least `2 E a`
/// (Johnson 1985, 3.36).
pub(super) fn of_stiffness(
    document: &Document,
    modulus: &Spanned<f64>,
    tools: &[Tool],
) -> Option<Flaw> {
    let most = f64::from(MAX_TANGENT);
    let modulus_pa = *modulus.get_ref();
    let radius_m = tools
        .iter()
        .map(|tool| tool.shape.radius_m())
        .fold(0.0, f64::max);
    let stiffness = 2.0 * modulus_pa * radius_m;
    if stiffness <= most {
        return None;
    }
    let message = format!(
        "youngs_modulus_pa = {modulus_pa:e}: a tool of {} on it feels up to {stiffness:.0e} N/m, and a frame takes {most:.0e} N/m",
        length(radius_m)
    );
    let help = match 1e-3 * stiffness <= most {
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
