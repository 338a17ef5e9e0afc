//! Scenes with needles: what is written arrives, and every kind of slip is told at its place.

use super::tests::{Slip, check_slips, read};
use super::*;
use crate::needle::NeedleShape;
use nalgebra::Vector3;

const GOOD: &str = r#"
seconds = 8.0
device = "cartesian-bench"
solve_at_s = 3.0

[[mesh.part]]
name = "upper"
slab = { size_m = [0.04, 0.03, 0.01], divisions = [8, 6, 2] }

[[mesh.part]]
name = "tube"
tube = { radii_m = [0.004, 0.006], length_m = 0.03, divisions = [1, 12, 6], axis = "x" }
at_m = [0.0, 0.0, -0.02]

[tissue]
youngs_modulus_pa = 20e3
poisson_ratio = 0.45
needle = { friction_n_per_m = 40.0, static_friction_n_per_m = 50.0, cutting_pa = 1e5, puncture_pa = 4e5 }

[[region]]
tag = "tube"
youngs_modulus_pa = 80e3
poisson_ratio = 0.4
needle = { friction_n_per_m = 90.0, viscous_n_s_per_m2 = 8.0, puncture_pa = inf }

[[fixed]]
plane = { axis = "x", at_m = -0.02 }
[[fixed]]
plane = { axis = "x", at_m = 0.015, within_m = 1e-4 }

[[tool]]
id = 2
shape = "grip"

[[tool.way_point]]
time_s = 1.0

[[tool.way_point]]
time_s = 3.0
rotation_deg = [0.0, 90.0, 0.0]

[[tool]]
id = 5
shape = "grip"
reach_m = 0.06

[[tool.way_point]]
time_s = 0.0
position_m = [0.0, 0.0, -0.1]

[[tool.way_point]]
time_s = 4.0
position_m = [0.0, 0.0, -0.06]

[[needle]]
shape = "arc"
radius_m = 0.012
angle_deg = 180.0
thickness_m = 0.0008
end_m = [-0.012, 0.0, 0.02]
direction = [0.0, 0.0, 5.0]
towards = [2.0, 0.0, 7.0]
[[needle.hold]]
time_s = 0.0
tool = 2
[[needle.hold]]
time_s = 5.0
[[needle.hold]]
time_s = 6.0
tool = 5

[[needle]]
id = 9
shape = "straight"
length_m = 0.03
thickness_m = 0.001
end_m = [0.0, 0.0, 0.05]
direction = [0.0, 0.0, -1.0]
[[needle.hold]]
time_s = 0.0

[needle_solver]
playback = "every-pose"

[hand]
stiffness_n_per_m = 800.0
damping_n_s_per_m = 8.0
way_point = [{ time_s = 0.0, position_m = [-0.012, 0.0, 0.02] }]
"#;

#[test]
fn what_is_written_arrives() {
    let scene = read(GOOD).expect("good");
    assert!(scene.warnings.is_empty(), "{:?}", scene.warnings);
    assert_eq!(scene.solve_at_s, Some(3.0));
    let expected = NeedleSolver {
        playback: crate::needle::Playback::EveryPose,
    };
    assert_eq!(scene.needle_solver, expected);
    let [arc, straight] = scene.needles.as_slice() else {
        panic!("{:?}", scene.needles)
    };
    assert_eq!((arc.id, straight.id), (0, 9));
    let hold = |time_s, tool| Hold { time_s, tool };
    let holds = [hold(0.0, Some(2)), hold(5.0, None), hold(6.0, Some(5))];
    assert_eq!(arc.holds, holds);
    assert_eq!(arc.needle.thickness_m, 0.0008);
    let NeedleShape::Arc {
        radius_m,
        angle_rad,
    } = arc.needle.shape
    else {
        panic!("{:?}", arc.needle)
    };
    assert_eq!((radius_m, angle_rad), (0.012, std::f64::consts::PI));
    // Up from the end, over the top, and down again: the centre lies on +x of the end.
    let curve = arc.needle.at(&arc.start);
    let near = |alpha: f64, x: [f64; 3]| (curve.at(alpha) - Vector3::from(x)).norm() < 1e-15;
    assert!(near(0.0, [-0.012, 0.0, 0.02]));
    assert!(near(0.5 * curve.length, [0.0, 0.0, 0.032]));
    assert!(near(curve.length, [0.012, 0.0, 0.02]));
    let line = straight.needle.at(&straight.start);
    assert!((line.at(0.03) - Vector3::new(0.0, 0.0, 0.02)).norm() < 1e-15);
}

#[test]
fn segments_go_on_from_each_other() {
    let said = "shape = \"segments\"\nsegments = [{ length_m = 0.02 }, { length_m = 0.01, radius_m = 0.008 }]\n\
                towards = [1.0, 0.0, 0.0]\n";
    let text = GOOD.replace("shape = \"straight\"\nlength_m = 0.03\n", said);
    let scene = read(&text).expect("good");
    let needle = scene.needles[1].needle;
    assert_eq!(needle.shape.length_m(), 0.03);
    let curve = needle.at(&scene.needles[1].start);
    let near = |alpha: f64, x: [f64; 3]| (curve.at(alpha) - Vector3::from(x)).norm() < 1e-15;
    assert!(near(0.0, [0.0, 0.0, 0.05]) && near(0.02, [0.0, 0.0, 0.03]));
    let (sin, cos) = (0.01f64 / 0.008).sin_cos();
    assert!(near(0.03, [0.008 * (1.0 - cos), 0.0, 0.03 - 0.008 * sin]));
}

/// Regions take what they leave out from the tissue, but a friction of their own has no foreign static one.
#[test]
fn each_cell_answers_as_its_part_says() {
    let scene = read(GOOD).expect("good");
    assert_eq!(scene.needle_tissue.len(), scene.mesh.cells().len());
    let of = |region: i64| {
        let cells = scene.mesh.regions().iter().zip(&scene.needle_tissue);
        let mut kinds: Vec<_> = cells.filter(|(r, _)| **r == region).collect();
        kinds.dedup();
        assert_eq!(kinds.len(), 1, "{kinds:?}");
        *kinds[0].1
    };
    let upper = NeedleTissue {
        friction_n_per_m: 40.0,
        static_friction_n_per_m: 50.0,
        viscous_n_s_per_m2: 0.0,
        cutting_pa: 1e5,
        puncture_pa: 4e5,
        surface_friction: f64::INFINITY,
    };
    assert_eq!(of(1), upper);
    let tube = NeedleTissue {
        friction_n_per_m: 90.0,
        static_friction_n_per_m: 90.0,
        viscous_n_s_per_m2: 8.0,
        cutting_pa: 1e5,
        puncture_pa: f64::INFINITY,
        surface_friction: f64::INFINITY,
    };
    assert_eq!(of(2), tube);
}

#[test]
fn parts_lie_where_they_are_put() {
    let scene = read(GOOD).expect("good");
    let names: Vec<_> = scene.mesh.region_names().values().collect();
    assert_eq!(names, ["upper", "tube"]);
    let nodes_of_slab = 9 * 7 * 3;
    let points = scene.mesh.points_m();
    assert_eq!(points.len(), nodes_of_slab + 2 * 12 * 7);
    for [x, y, z] in &points[nodes_of_slab..] {
        let radius = y.hypot(z + 0.02);
        let on_wall = [0.004, 0.006].iter().any(|r| (radius - r).abs() < 1e-15);
        assert!(on_wall && x.abs() < 0.0151, "{x} {y} {z}");
    }
}

#[test]
fn scripts_begin_where_their_first_point_is() {
    let scene = read(GOOD).expect("good");
    let [driven, second] = scene.tools.as_slice() else {
        panic!("{:?}", scene.tools)
    };
    assert!(driven.shape.shape == tool::Shape::Grip && driven.driven && driven.pose.is_none());
    let way = driven.way.as_ref().expect("it turns");
    assert_eq!(way.at(1.0).moved, None, "the console says where");
    let half = 22.5f64.to_radians();
    let [x, y, z, w] = way.at(2.0).orientation;
    assert!((y - half.sin()).abs() < 1e-15 && (w - half.cos()).abs() < 1e-15);
    assert_eq!((x, z), (0.0, 0.0));
    let pose = second.pose.expect("it has a place");
    assert_eq!(pose.position_m, [0.0, 0.0, -0.1]);
    let held: Vec<_> = scene.held().map(|(tool, _)| tool.id).collect();
    assert_eq!(held, [5]);
}

#[test]
fn a_scene_without_needles_has_nothing_of_them() {
    let plain = &GOOD[..GOOD.find("[[tool]]").expect("tools")];
    let plain = plain.replace("solve_at_s = 3.0", "");
    let scene = read(&plain).expect("it only warns");
    assert!(scene.needles.is_empty() && scene.needle_tissue.is_empty());
    let warning = scene.warnings[0].to_string();
    assert!(warning.contains("there are none"), "{warning}");
    let idle = format!("{plain}[[tool]]\nshape = \"grip\"\n");
    let scene = read(&idle).expect("it only warns");
    let warnings: Vec<_> = scene.warnings.iter().map(|w| w.to_string()).collect();
    assert!(
        warnings.iter().any(|w| w.contains("holds no needle")),
        "{warnings:?}"
    );
}

const SLIPS: &[Slip] = &[
    Slip {
        from: "solve_at_s = 3.0",
        to: "solve_at_s = -3.0",
        message: "solve_at_s = -3: must be from 0 to 86400",
        under: "-3.0",
        help: "since the session begins",
    },
    Slip {
        from: "slab = { size_m = [0.04, 0.03, 0.01], divisions = [8, 6, 2] }",
        to: "",
        message: "a part is one slab or one tube",
        under: "[[mesh.part]]",
        help: "another `[[mesh.part]]`",
    },
    Slip {
        from: "radii_m = [0.004, 0.006]",
        to: "radii_m = [0.006, 0.004]",
        message: "radii_m: the inner radius must be positive, the outer one larger",
        under: "[0.006, 0.004]",
        help: "[inner, outer]",
    },
    Slip {
        from: "divisions = [1, 12, 6]",
        to: "divisions = [1, 2, 6]",
        message: "tube",
        under: "{ radii_m = [0.004, 0.006], length_m = 0.03, divisions = [1, 2, 6], axis = \"x\" }",
        help: "at least 3 around",
    },
    Slip {
        from: "divisions = [1, 12, 6]",
        to: "divisions = [1, 12, 0]",
        message: "divisions: must be 1 or more along each axis",
        under: "[1, 12, 0]",
        help: "cubes",
    },
    Slip {
        from: "axis = \"x\" }\nat_m",
        to: "axis = \"u\" }\nat_m",
        message: "unknown value `u`",
        under: "\"u\"",
        help: "`x`",
    },
    Slip {
        from: "tag = \"tube\"",
        to: "tag = \"tub\"",
        message: "the mesh has no region \"tub\"",
        under: "\"tub\"",
        help: "did you mean \"tube\"?",
    },
    Slip {
        from: "friction_n_per_m = 40.0, ",
        to: "",
        message: "missing key `friction_n_per_m`",
        under: "{ static_friction_n_per_m = 50.0, cutting_pa = 1e5, puncture_pa = 4e5 }",
        help: "10 to 100 N/m",
    },
    Slip {
        from: ", puncture_pa = 4e5",
        to: "",
        message: "missing key `puncture_pa`",
        under: "{ friction_n_per_m = 40.0, static_friction_n_per_m = 50.0, cutting_pa = 1e5 }",
        help: "1e5 to 1e6 Pa",
    },
    Slip {
        from: "static_friction_n_per_m = 50.0",
        to: "static_friction_n_per_m = 30.0",
        message: "static_friction_n_per_m = 30: must be at least 40",
        under: "30.0",
        help: "no less than",
    },
    Slip {
        from: "puncture_pa = 4e5",
        to: "puncture_pa = -inf",
        message: "puncture_pa = -inf: must be zero or positive",
        under: "-inf",
        help: "`inf` is never",
    },
    Slip {
        from: "cutting_pa = 1e5",
        to: "cutting_pa = inf",
        message: "cutting_pa = inf: must be zero or positive",
        under: "inf",
        help: "cuts on",
    },
    Slip {
        from: "needle = { friction_n_per_m = 40.0, static_friction_n_per_m = 50.0, cutting_pa = 1e5, puncture_pa = 4e5 }",
        to: "",
        message: "a region answers needles in its own way, but the tissue in none",
        under: "{ friction_n_per_m = 90.0, viscous_n_s_per_m2 = 8.0, puncture_pa = inf }",
        help: "add `[tissue.needle]`",
    },
    Slip {
        from: "shape = \"grip\"\n\n[[tool.way_point]]\ntime_s = 1.0",
        to: "\n\n[[tool.way_point]]\ntime_s = 1.0",
        message: "missing key `radius_m`",
        under: "[[tool]]",
        help: "shape = \"grip\"",
    },
    Slip {
        from: "id = 2\nshape = \"grip\"",
        to: "id = 2\nshape = \"grip\"\nbody = { radius_m = 0.0, length_m = 0.05 }",
        message: "radius_m",
        under: "0.0",
        help: "needle holders",
    },
    Slip {
        from: "id = 2\nshape = \"grip\"",
        to: "id = 2\nshape = \"grip\"\nbody = { radius_m = 0.002 }",
        message: "missing key `length_m`",
        under: "{ radius_m = 0.002 }",
        help: "",
    },
    Slip {
        from: "id = 2\nshape = \"grip\"",
        to: "id = 2\nshape = \"grip\"\nbody = { radius_m = 0.002, length_m = 0.05, friction = -0.1 }",
        message: "friction",
        under: "-0.1",
        help: "wet metal",
    },
    Slip {
        from: "id = 2\nshape = \"grip\"",
        to: "id = 2\nshape = \"grip\"\nradius_m = 0.01",
        message: "a grip touches nothing",
        under: "0.01",
        help: "leave this key out",
    },
    Slip {
        from: "id = 2\nshape = \"grip\"",
        to: "id = 2\nshape = \"grip\"\norientation = [0.0, 0.0, 0.0, 1.0]",
        message: "an orientation beside way points",
        under: "[0.0, 0.0, 0.0, 1.0]",
        help: "`rotation_deg`",
    },
    Slip {
        from: "id = 5\nshape = \"grip\"",
        to: "id = 5\nshape = \"grip\"\nposition_m = [0.0, 0.0, 0.1]",
        message: "a position beside way points",
        under: "[0.0, 0.0, 0.1]",
        help: "leave `position_m` out",
    },
    Slip {
        from: "time_s = 1.0\n",
        to: "time_s = 1.0\nposition_m = [0.0, 0.0, 0.1]\n",
        message: "a position for a tool that the console carries",
        under: "[0.0, 0.0, 0.1]",
        help: "`[hand]`",
    },
    Slip {
        from: "time_s = 4.0\nposition_m = [0.0, 0.0, -0.06]",
        to: "time_s = 4.0",
        message: "a way point without a place",
        under: "[[tool.way_point]]",
        help: "does not carry",
    },
    Slip {
        from: "time_s = 1.0\n",
        to: "time_s = 3.5\n",
        message: "time_s = 3: must be at least 3.5",
        under: "3.0",
        help: "do not go back",
    },
    Slip {
        from: "rotation_deg = [0.0, 90.0, 0.0]",
        to: "rotation_deg = [0.0, nan, 0.0]",
        message: "rotation_deg: every entry must be a finite number",
        under: "[0.0, nan, 0.0]",
        help: "",
    },
    Slip {
        from: "radius_m = 0.012\n",
        to: "",
        message: "missing key `radius_m`",
        under: "[[needle]]",
        help: "add `radius_m",
    },
    Slip {
        from: "radius_m = 0.012\n",
        to: "radius_m = 0.012\nlength_m = 0.03\n",
        message: "an arc's length is that of its radius and angle",
        under: "0.03",
        help: "leave `length_m` out",
    },
    Slip {
        from: "angle_deg = 180.0",
        to: "angle_deg = 360.0",
        message: "angle_deg = 360: must be more than 0 and less than 360",
        under: "360.0",
        help: "half a circle",
    },
    Slip {
        from: "thickness_m = 0.0008",
        to: "thickness_m = 0.0",
        message: "thickness_m = 0: must be positive",
        under: "0.0",
        help: "diameter",
    },
    Slip {
        from: "direction = [0.0, 0.0, 5.0]",
        to: "direction = [0.0, 0.0, 0.0]",
        message: "direction: a direction without length",
        under: "[0.0, 0.0, 0.0]",
        help: "not all zero",
    },
    Slip {
        from: "towards = [2.0, 0.0, 7.0]",
        to: "towards = [0.0, 0.0, -7.0]",
        message: "towards: along `direction`",
        under: "[0.0, 0.0, -7.0]",
        help: "circle's centre",
    },
    Slip {
        from: "towards = [2.0, 0.0, 7.0]\n",
        to: "",
        message: "an arc that does not say to which side it bends",
        under: "[0.0, 0.0, 5.0]",
        help: "add `towards",
    },
    Slip {
        from: "length_m = 0.03\nthickness_m",
        to: "length_m = 0.03\nangle_deg = 90.0\nthickness_m",
        message: "a straight needle has no radius, angle or side",
        under: "90.0",
        help: "shape = \"arc\"",
    },
    Slip {
        from: "shape = \"straight\"\nlength_m = 0.03\n",
        to: "shape = \"segments\"\nsegments = []\n",
        message: "0 segments",
        under: "[]",
        help: "1 to 6",
    },
    Slip {
        from: "shape = \"straight\"\nlength_m = 0.03\n",
        to: "shape = \"segments\"\nsegments = [{ length_m = 0.03 }]\nlength_m = 0.03\n",
        message: "a needle of segments has the lengths",
        under: "0.03",
        help: "put it into",
    },
    Slip {
        from: "shape = \"straight\"\nlength_m = 0.03\n",
        to: "shape = \"segments\"\nsegments = [{ length_m = 0.03, radius_m = -1.0 }]\n",
        message: "radius_m = -1: must be positive",
        under: "-1.0",
        help: "straight",
    },
    Slip {
        from: "shape = \"straight\"\nlength_m = 0.03\n",
        to: "shape = \"segments\"\nsegments = [{ length_m = 0.07, radius_m = 0.01 }]\n",
        message: "the segments turn by 401 degrees",
        under: "[{ length_m = 0.07, radius_m = 0.01 }]",
        help: "360",
    },
    Slip {
        from: "shape = \"straight\"\nlength_m = 0.03\n",
        to: "shape = \"segments\"\nsegments = [{ length_m = 0.01, radius_m = 0.01 }]\n",
        message: "an arc that does not say to which side",
        under: "[0.0, 0.0, -1.0]",
        help: "add `towards",
    },
    Slip {
        from: "end_m = [0.0, 0.0, 0.05]",
        to: "end_m = [0.0, 0.0, 0.02]",
        message: "this needle starts inside the tissue, 20.6 mm from its end",
        under: "[0.0, 0.0, 0.02]",
        help: "comes from outside",
    },
    Slip {
        from: "id = 9",
        to: "id = 0",
        message: "two needles have the id 0",
        under: "0",
        help: "0 to 255",
    },
    Slip {
        from: "[[needle.hold]]\ntime_s = 0.0\n\n[needle_solver]",
        to: "[needle_solver]",
        message: "nobody holds this needle",
        under: "[[needle]]",
        help: "add `[[needle.hold]]`",
    },
    Slip {
        from: "time_s = 0.0\ntool = 2",
        to: "time_s = 0.5\ntool = 2",
        message: "time_s = 0.5: must be 0, the first",
        under: "0.5",
        help: "from 0 on",
    },
    Slip {
        from: "time_s = 6.0",
        to: "time_s = 4.0",
        message: "time_s = 4: must be at least 5, the time before it",
        under: "4.0",
        help: "do not go back",
    },
    Slip {
        from: "tool = 5",
        to: "tool = 7",
        message: "there is no tool 7",
        under: "7",
        help: "[2, 5]",
    },
    Slip {
        from: "[[needle.hold]]\ntime_s = 0.0\n\n[needle_solver]",
        to: "[[needle.hold]]\ntime_s = 0.0\ntool = 2\n\n[needle_solver]",
        message: "tool 2 holds the needles 9 and 0 at 0 s",
        under: "[[needle.hold]]",
        help: "let one needle go",
    },
    Slip {
        from: "playback = \"every-pose\"",
        to: "playback = \"every-posse\"",
        message: "unknown value `every-posse`",
        under: "\"every-posse\"",
        help: "did you mean `every-pose`?",
    },
];

#[test]
fn every_slip_is_told_at_its_place_with_a_way_out() {
    check_slips(GOOD, SLIPS);
    let [_, rest] = GOOD
        .split("[[needle]]")
        .next()
        .map(|tools| [tools, "[needle_solver]\nplayback = \"one-solve\"\n"])
        .expect("tools");
    let without = GOOD.split("[[needle]]").next().expect("tools");
    let without = without.replace("solve_at_s = 3.0\n", "") + rest;
    let message = read(&without).expect_err("no needle").to_string();
    assert!(message.contains("settings for needles"), "{message}");
    let timed = GOOD.split("[[tool]]").next().expect("tissue");
    let refused = read(timed).map(|_| ()).expect_err("nothing that moves");
    let message = refused.to_string();
    assert!(message.contains("a time to solve at"), "{message}");
    let silent = GOOD.replace("needle = {", "# needle = {");
    let message = read(&silent).expect_err("says nothing").to_string();
    assert!(message.contains("nothing that says"), "{message}");
}

/// The body of a grip is a bar along its axis; other tools have none beside their shape.
#[test]
fn a_grip_has_a_body() {
    let body =
        "body = { radius_m = 0.002, length_m = 0.05, axis = [0.0, 2.0, 0.0], friction = 0.2 }";
    let text = GOOD.replacen("shape = \"grip\"", &format!("shape = \"grip\"\n{body}"), 1);
    let scene = read(&text).expect("good");
    let parts: Vec<_> = scene.bars().collect();
    let bar = Bar {
        offset_m: [0.0; 3],
        axis: [0.0, 1.0, 0.0],
        radius_m: 0.002,
        length_m: 0.05,
        friction: 0.2,
    };
    assert_eq!(parts.iter().map(|part| part.bar).collect::<Vec<_>>(), [bar]);
    let seen = scene.tools.iter().find(|tool| tool.body.is_some());
    let seen = seen.expect("a body").seen();
    assert_eq!((seen.radius_m(), seen.axis), (0.002, [0.0, 1.0, 0.0]));
    scene.build().expect("a model");
    assert!(read(GOOD).expect("good").bars().next().is_none());
    // However long the vector is.
    let long = read(&text.replace("[0.0, 2.0, 0.0]", "[0.0, 1e300, 0.0]")).expect("good");
    assert_eq!(long.bars().map(|part| part.bar).collect::<Vec<_>>(), [bar]);
}
