//! Gravity and densities: what arrives, and what is told of those that are none.

use super::Scene;
use super::tests::{Slip, check_slips, read};

const GOOD: &str = r#"
gravity_m_per_s2 = [0.0, 0.0, -9.81]

[[mesh.part]]
name = "fat"
slab = { size_m = [0.02, 0.02, 0.01], divisions = [2, 2, 1] }

[[mesh.part]]
name = "muscle"
slab = { size_m = [0.02, 0.02, 0.02], divisions = [2, 2, 2] }
at_m = [0.05, 0.0, 0.0]

[tissue]
model = "corotational"
youngs_modulus_pa = 15e3
poisson_ratio = 0.45
density_kg_per_m3 = 1060.0

[[region]]
tag = "fat"
youngs_modulus_pa = 5e3
poisson_ratio = 0.45
density_kg_per_m3 = 920.0

[[fixed]]
plane = { axis = "z", at_m = -0.01 }
"#;
/// What makes a scene with a needle that falls of it.
const NEEDLE: &str = r#"
[tissue.needle]
friction_n_per_m = 5.0
puncture_pa = 5e5

[[tool]]
shape = "grip"

[[needle]]
shape = "straight"
length_m = 0.02
thickness_m = 0.0008
end_m = [0.0, 0.0, 0.05]
direction = [0.0, 0.0, -1.0]
body = true
density_kg_per_m3 = 7900.0

[[needle.hold]]
time_s = 0.0
"#;
const GRAVITY: &str = "gravity_m_per_s2 = [0.0, 0.0, -9.81]";
const REGION: &str = "density_kg_per_m3 = 920.0";
const TISSUE: &str = "density_kg_per_m3 = 1060.0";

fn warnings(text: &str) -> Vec<String> {
    let scene = read(text).expect("good");
    scene.warnings.iter().map(ToString::to_string).collect()
}

#[test]
fn every_part_weighs_what_its_density_says() {
    let gravity = |text: &str| read(text).expect("good").gravity.expect("some");
    let volumes = [0.02 * 0.02 * 0.01, 0.02 * 0.02 * 0.02];
    let near = |mass: f64, expected: f64| (mass / expected - 1.0).abs() < 1e-12;
    let both = gravity(GOOD);
    assert_eq!(both.m_per_s2, [0.0, 0.0, -9.81]);
    assert!(near(both.mass_kg, volumes[0] * 920.0 + volumes[1] * 1060.0));
    let fallen: f64 = both.on_nodes.iter().map(|load| load.force_n[2]).sum();
    assert!(near(fallen, -9.81 * both.mass_kg));
    // A region that says nothing has what the tissue has.
    let one = gravity(&GOOD.replace(REGION, ""));
    assert!(near(one.mass_kg, (volumes[0] + volumes[1]) * 1060.0));
    let none = GOOD
        .replace(GRAVITY, "")
        .replace(REGION, "")
        .replace(TISSUE, "");
    assert!(read(&none).expect("good").gravity.is_none());
    assert!(warnings(GOOD).is_empty(), "{:?}", warnings(GOOD));
    assert!(warnings(&none).is_empty());
}

#[test]
fn densities_that_do_nothing_or_are_hardly_any_are_warned_of() {
    let idle = "a density, but no gravity: it has no effect";
    assert_eq!(warnings(&GOOD.replace(GRAVITY, "")), [idle, idle]);
    // Models with masses have a use for that of the tissue, and none for that of a region.
    let masses = GOOD.replace("corotational", "shape-matching");
    assert_eq!(warnings(&masses.replace(GRAVITY, "")), [idle]);
    let said = warnings(&GOOD.replace(REGION, "density_kg_per_m3 = 1.06"));
    assert_eq!(
        said,
        ["density_kg_per_m3 = 1.06: hardly any tissue is so light"]
    );
    let scene = read(&GOOD.replace(REGION, "density_kg_per_m3 = 1.06")).expect("good");
    let help = miette::Diagnostic::help(&scene.warnings[0]).map(|help| help.to_string());
    assert!(help.expect("some").ends_with("times 1000 yours is 1060"));
}

#[test]
fn where_tissue_begins_is_told_where_it_cannot_be_chosen() {
    let said = |model: &str, first: &str| {
        warnings(&GOOD.replace("corotational", model).replace(GRAVITY, first))
    };
    let falls = format!("{GRAVITY}\nsettle = false");
    let none = Vec::<String>::new();
    assert_eq!(said("corotational", &falls), none);
    assert_eq!(
        said("corotational", &format!("{GRAVITY}\nsettle = true")),
        none
    );
    assert!(said("linear", &falls)[0].contains("at rest with the first solve"));
    let idle = said("corotational", "settle = false");
    assert!(
        idle.iter()
            .any(|words| words.contains("nothing acts on the tissue")),
        "{idle:?}"
    );
    let is_settled = |text: &str| read(text).expect("good").settle;
    assert!(is_settled(GOOD) && !is_settled(&GOOD.replace(GRAVITY, &falls)));
}

#[test]
fn needles_fall_with_the_scenes_gravity() {
    let text = [GOOD, NEEDLE].concat();
    let scene = read(&text).expect("good");
    let weight = scene.needles[0].weight.expect("a weight");
    assert_eq!(weight.gravity_m_per_s2, [0.0, 0.0, -9.81]);
    assert_eq!(weight.density_kg_per_m3, 7900.0);
    let idle = |scene: &Scene| {
        let warnings = scene.warnings.iter().map(ToString::to_string);
        let idle = warnings.filter(|words| words.contains("a density, but no gravity"));
        idle.count()
    };
    assert_eq!(idle(&scene), 0);
    let light = read(&text.replace("density_kg_per_m3 = 7900.0", "")).expect("good");
    assert_eq!(light.needles[0].weight, None);
    let none = read(&text.replace(GRAVITY, "")).expect("good");
    assert_eq!(none.needles[0].weight, None);
    assert_eq!(idle(&none), 3);
    check_slips(&text, NEEDLE_SLIPS);
}

const NEEDLE_SLIPS: &[Slip] = &[
    Slip {
        from: "body = true\n",
        to: "",
        message: "a needle that weighs something, and has no body to lie on the tissue with",
        under: "7900.0",
        help: "add `body = true`",
    },
    Slip {
        from: "density_kg_per_m3 = 7900.0",
        to: "density_kg_per_m3 = 7.9e6",
        message: "density_kg_per_m3 = 7900000: must be from 1 to 30000",
        under: "7.9e6",
        help: "steel has 7900",
    },
];

#[test]
fn gravity_that_is_none_is_told_at_its_place() {
    check_slips(GOOD, SLIPS);
    // Without any density the first cell that has none is of the region.
    check_slips(&GOOD.replace(TISSUE, ""), WITHOUT_TISSUE);
}

const SLIPS: &[Slip] = &[
    Slip {
        from: GRAVITY,
        to: "gravity_m_per_s2 = [0.0, 0.0, -9810.0]",
        message: "gravity_m_per_s2 is 9810 m/s^2 strong: must be at most 30",
        under: "[0.0, 0.0, -9810.0]",
        help: "times 0.001, from mm/s^2, yours is [0.0, 0.0, -9.81]",
    },
    Slip {
        from: GRAVITY,
        to: "gravity_m_per_s2 = [0.0, 0.0, nan]",
        message: "gravity_m_per_s2: every entry must be a finite number",
        under: "[0.0, 0.0, nan]",
        help: "",
    },
    Slip {
        from: GRAVITY,
        to: "gravity_m_per_s2 = -9.81",
        message: "a list of 3 is needed",
        under: "-9.81",
        help: "",
    },
    Slip {
        from: TISSUE,
        to: "density_kg_per_m3 = -1060.0",
        message: "density_kg_per_m3 = -1060: must be from 1 to 30000",
        under: "-1060.0",
        help: "water has 1000",
    },
    Slip {
        from: REGION,
        to: "density_kg_per_m3 = 920e3",
        message: "density_kg_per_m3 = 920000: must be from 1 to 30000",
        under: "920e3",
        help: "times 1e-3 yours is 920",
    },
    Slip {
        from: REGION,
        to: "density_kg_per_m3 = 9.2e-7",
        message: "must be from 1 to 30000",
        under: "9.2e-7",
        help: "times 1e9 yours is 920",
    },
    Slip {
        from: TISSUE,
        to: "",
        message: "gravity, but nothing says what the tissue weighs",
        under: "[0.0, 0.0, -9.81]",
        help: "add to `[tissue]` `density_kg_per_m3`",
    },
    Slip {
        from: "plane = { axis = \"z\", at_m = -0.01 }",
        to: "box = { min_m = [-1.0, -1.0, -1.0], max_m = [0.02, 1.0, -0.009] }",
        message: "nothing holds the part of the tissue with node",
        under: "[0.0, 0.0, -9.81]",
        help: "add a `[[fixed]]`",
    },
    Slip {
        from: GRAVITY,
        to: "gravity_m_per_s2 = [0.0, 0.0, -9.81]\nsettle = false\nhandle = [{ vertices = [17], barycentric = [1.0], target_displacement_m = [0.0, 0.0, 0.001] }]",
        message: "handles are brought to tissue at rest",
        under: "false",
        help: "leave `settle` out",
    },
];

const WITHOUT_TISSUE: &[Slip] = &[Slip {
    from: REGION,
    to: "",
    message: "gravity, but nothing says what region \"fat\" weighs",
    under: "[[region]]",
    help: "or to `[tissue]` for all of them",
}];
