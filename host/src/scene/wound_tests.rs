//! Scenes with threads and tissue that touches: what is written arrives, and every kind of slip is told at its place.

use super::tests::{Slip, check_slips, read};
use super::*;
use crate::thread::{ThreadBody, ThreadContact, ThreadEnd, ThreadHold, ThreadPart, Through};

const GOOD: &str = r#"
device = "cartesian-bench"

[[mesh.part]]
name = "left"
slab = { size_m = [0.02, 0.03, 0.01], divisions = [4, 6, 2] }
at_m = [-0.012, 0.0, 0.0]

[[mesh.part]]
name = "right"
slab = { size_m = [0.02, 0.03, 0.01], divisions = [4, 6, 2] }
at_m = [0.012, 0.0, 0.0]

[tissue]
youngs_modulus_pa = 20e3
poisson_ratio = 0.45
needle = { friction_n_per_m = 0.0, puncture_pa = 4e5 }

[[fixed]]
plane = { axis = "z", at_m = -0.01 }

[[tool]]
id = 2
shape = "grip"

[[tool]]
id = 5
shape = "grip"
position_m = [0.0, 0.0, 0.1]

[[needle]]
id = 3
shape = "straight"
length_m = 0.03
thickness_m = 0.0008
end_m = [0.0, 0.0, 0.05]
direction = [0.0, 0.0, -1.0]
[[needle.hold]]
time_s = 0.0
tool = 2

[[thread]]
needle = 3
length_m = 0.4
friction = 0.1
strength_n = 12.0

[[thread.hold]]
time_s = 0.0
end = "tail"
knot = true

[[thread.hold]]
time_s = 1.0
end = "tail"

[[thread.hold]]
time_s = 1.5
end = "head"
tool = 5

[[thread.hold]]
time_s = 1.5
end = "tail"
at_m = [0.0, 0.1, 0.2]

[[thread.tighten]]
time_s = 2.0
until_s = 3.0
ratio = 0.5

[[thread.tighten]]
time_s = 4.0
until_s = 5.0
ratio = 0.2

[[tissue_contact]]
between = ["left", "right"]
friction = 0.3
rims = [{ plane = { axis = "x", at_m = -0.002 } }, { plane = { axis = "x", at_m = 0.002 } }]

[[tissue_contact]]
between = [2, 2]
"#;

#[test]
fn threads_arrive_as_they_are_written() {
    let scene = read(GOOD).expect("good");
    assert!(scene.warnings.is_empty(), "{:?}", scene.warnings);
    let [thread] = scene.threads.as_slice() else {
        panic!("{:?}", scene.threads)
    };
    let part = ThreadPart {
        id: 0,
        needle: 3,
        length_m: 0.4,
        friction: 0.1,
        strength_n: 12.0,
        through: Through::default(),
    };
    assert_eq!(thread.part, part);
    let held = |time_s, end, by| ThreadHeld { time_s, end, by };
    assert_eq!(
        thread.holds,
        [
            held(0.0, ThreadEnd::Tail, ThreadHold::Knot),
            held(1.0, ThreadEnd::Tail, ThreadHold::Free),
            held(1.5, ThreadEnd::Head, ThreadHold::Tool(5)),
            held(1.5, ThreadEnd::Tail, ThreadHold::Place([0.0, 0.1, 0.2])),
        ]
    );
    let short = GOOD.replace("friction = 0.1\nstrength_n = 12.0\n", "");
    let scene = read(&short).expect("good");
    let part = scene.threads[0].part;
    assert_eq!((part.friction, part.strength_n), (0.0, 20.0));
}

#[test]
fn a_span_is_held_like_an_end() {
    let scene = read(&GOOD.replace("end = \"head\"", "end = \"span\"")).expect("good");
    let held = ThreadHeld {
        time_s: 1.5,
        end: ThreadEnd::Span,
        by: ThreadHold::Tool(5),
    };
    assert_eq!(scene.threads[0].holds[2], held);
}

/// What is left out does not give way.
#[test]
fn a_thread_stretches_drags_and_slips_as_its_keys_say() {
    let through = |keys: &str| {
        let said = format!("strength_n = 12.0\n{keys}\n");
        let scene = read(&GOOD.replace("strength_n = 12.0\n", &said));
        scene.expect("good").threads[0].part.through
    };
    let stiff = Through::default();
    assert!(stiff.axial_stiffness_n.is_infinite() && stiff.grip_n.is_infinite());
    for keys in [
        "",
        "axial_stiffness_n = inf",
        "drag_n_per_m = 0.0",
        "grip_n = inf",
        "knot_n = inf",
    ] {
        assert_eq!(through(keys), stiff, "{keys}");
    }
    let all = through("axial_stiffness_n = 200.0\ndrag_n_per_m = 5.0\ngrip_n = 3.0\nknot_n = 8.0");
    let expected = Through {
        axial_stiffness_n: 200.0,
        drag_n_per_m: 5.0,
        grip_n: 3.0,
        knot_n: 8.0,
        ..Through::default()
    };
    assert_eq!(all, expected);
    let presses = through("thickness_m = 0.2e-3\ntear_pa = 3e5");
    let expected = Through {
        thickness_m: 0.2e-3,
        tear_pa: 3e5,
        ..stiff
    };
    assert_eq!(presses, expected);
    let bends = through("body = true");
    assert_eq!(
        bends,
        Through {
            body: true,
            ..stiff
        }
    );
}

/// 3.37 of the source with `ratio` from 1 on; at rest between and after the two sections.
#[test]
fn tightening_goes_in_proportion_to_time() {
    let scene = read(GOOD).expect("good");
    let ratio = |time_s| scene.threads[0].tightened(time_s).map(|to| to.of(0, 1));
    assert_eq!((ratio(1.99), ratio(2.0)), (None, Some(1.0)));
    assert_eq!((ratio(2.5), ratio(3.0)), (Some(0.75), Some(0.5)));
    assert_eq!((ratio(3.5), ratio(4.0)), (Some(0.5), Some(0.5)));
    let half_way = ratio(4.5).expect("it has begun");
    assert!((half_way - 0.35).abs() < 1e-15, "{half_way}");
    assert_eq!((ratio(5.0), ratio(1e3)), (Some(0.2), Some(0.2)));
    // All at once.
    let text = GOOD.replace("until_s = 3.0", "until_s = 2.0");
    let scene = read(&text).expect("good");
    let tightened = scene.threads[0].tightened(2.0).expect("it has begun");
    assert_eq!(tightened.of(0, 1), 0.5);
}

/// A third of the way through three spans: the first is done, the others have not begun.
#[test]
fn spans_are_tightened_in_turn() {
    let text = GOOD.replace("until_s = 3.0", "until_s = 3.0\nin_turn = true");
    let scene = read(&text).expect("good");
    let at = |time_s| {
        let to = scene.threads[0].tightened(time_s).expect("it has begun");
        [0, 1, 2, 3].map(|place| to.of(place, 4))
    };
    assert_eq!(at(2.25), [0.5, 1.0, 1.0, 1.0]);
    assert_eq!(at(2.625), [0.5, 0.5, 0.75, 1.0]);
    assert_eq!(at(3.5), [0.5; 4]);
}

#[test]
fn parts_that_touch_have_their_own_faces_and_rims() {
    let scene = read(GOOD).expect("good");
    let [pair, itself] = scene.touching.as_slice() else {
        panic!("{:?}", scene.touching)
    };
    assert_eq!(pair.between, ["left", "right"]);
    assert_eq!((pair.friction, itself.friction), (0.3, 0.0));
    // Two triangles a square: 2 (4 x 6 + 4 x 2 + 6 x 2) squares a slab.
    let each = 4 * (4 * 6 + 4 * 2 + 6 * 2);
    let points = scene.mesh.points_m();
    for (side, faces) in pair.faces.iter().enumerate() {
        assert_eq!(faces.len(), each);
        let sign = [-1.0, 1.0][side];
        let xs = faces
            .iter()
            .flatten()
            .map(|n| sign * points[*n as usize][0]);
        assert!(xs.into_iter().all(|x| x > 0.0), "the {side} one");
    }
    // The gap's faces: 7 x 3 nodes.
    for (side, rim) in pair.rims.iter().enumerate() {
        let x = [-0.002, 0.002][side];
        assert_eq!(rim.len(), 7 * 3);
        let off = |n: &u32| (points[*n as usize][0] - x).abs();
        assert!(rim.iter().map(off).all(|off| off < 1e-9));
    }
    assert!(itself.is_within_one() && !pair.is_within_one());
    assert_eq!(itself.faces[0], pair.faces[1]);
    assert!(itself.rims.iter().all(Vec::is_empty));
}

const SLIPS: &[Slip] = &[
    Slip {
        from: "needle = 3\nlength_m",
        to: "needle = 0\nlength_m",
        message: "there is no needle 0",
        under: "0",
        help: "this scene's needles are [3]",
    },
    Slip {
        from: "length_m = 0.4",
        to: "length_m = 0.0",
        message: "length_m = 0: must be positive",
        under: "0.0",
        help: "from tail to head",
    },
    Slip {
        from: "friction = 0.1",
        to: "friction = -0.1",
        message: "friction = -0.1: must be between 0 and 10",
        under: "-0.1",
        help: "Coulomb",
    },
    Slip {
        from: "strength_n = 12.0",
        to: "strength_n = inf",
        message: "strength_n = inf: must be positive",
        under: "inf",
        help: "it would break",
    },
    Slip {
        from: "strength_n = 12.0",
        to: "axial_stiffness_n = 0.0",
        message: "axial_stiffness_n = 0: must be positive",
        under: "0.0",
        help: "tension over strain",
    },
    Slip {
        from: "strength_n = 12.0",
        to: "drag_n_per_m = inf",
        message: "drag_n_per_m = inf: must be zero or positive",
        under: "inf",
        help: "force per length",
    },
    Slip {
        from: "strength_n = 12.0",
        to: "grip_n = -1.0",
        message: "grip_n = -1: must be positive",
        under: "-1.0",
        help: "slips through a grip",
    },
    Slip {
        from: "strength_n = 12.0",
        to: "strength = 12.0",
        message: "unknown key `strength`",
        under: "strength",
        help: "did you mean `strength_n`?",
    },
    Slip {
        from: "[[thread]]\nneedle = 3",
        to: "[[thread]]\nneedle = 3\nlength_m = 1.0\n[[thread]]\nneedle = 3",
        message: "needle 3 has a thread already",
        under: "3",
        help: "one thread is fastened",
    },
    Slip {
        from: "[[thread]]\nneedle = 3",
        to: "[[thread]]\nneedle = 3\nlength_m = 1.0\n[[thread]]\nid = 0\nneedle = 3",
        message: "two threads have the id 0",
        under: "0",
        help: "an `id` of its own",
    },
    Slip {
        from: "strength_n = 12.0",
        to: "strength_n = 12.0\ncut = [{ time_s = 1.0 }]",
        message: "a cut by nothing, or by two things",
        under: "{ time_s = 1.0 }",
        help: "give one of `tool` and `at_m`",
    },
    Slip {
        from: "strength_n = 12.0",
        to: "strength_n = 12.0\ncut = [{ time_s = 2.0, at_m = [0.0, 0.0, 0.1] }, { time_s = 1.0, at_m = [0.0, 0.0, 0.1] }]",
        message: "time_s = 1",
        under: "1.0",
        help: "",
    },
    Slip {
        from: "[[thread.tighten]]\ntime_s = 2.0",
        to: "[[thread.tighten]]\ntime_s = 1.25",
        message: "thread 0 is tightened at 1.25 s, and nothing holds its tail then",
        under: "1.25",
        help: "hold that before (`[[thread.hold]]` with `end = \"tail\"`",
    },
    Slip {
        from: "strength_n = 12.0",
        to: "strength_n = 12.0\ncut = [{ time_s = 1.0, tool = 77 }]",
        message: "there is no tool 77",
        under: "77",
        help: "this scene's tools are",
    },
    Slip {
        from: "strength_n = 12.0",
        to: "strength_n = 12.0\ncut = [{ time_s = 1.0, at_m = [0.0, 0.0, 0.1] }, { time_s = 2.0, at_m = [0.0, 0.0, 0.1] }, { time_s = 3.0, at_m = [0.0, 0.0, 0.1] }, { time_s = 4.0, at_m = [0.0, 0.0, 0.1] }, { time_s = 5.0, at_m = [0.0, 0.0, 0.1] }, { time_s = 6.0, at_m = [0.0, 0.0, 0.1] }, { time_s = 7.0, at_m = [0.0, 0.0, 0.1] }, { time_s = 8.0, at_m = [0.0, 0.0, 0.1] }, { time_s = 9.0, at_m = [0.0, 0.0, 0.1] }, { time_s = 10.0, at_m = [0.0, 0.0, 0.1] }, { time_s = 11.0, at_m = [0.0, 0.0, 0.1] }, { time_s = 12.0, at_m = [0.0, 0.0, 0.1] }, { time_s = 13.0, at_m = [0.0, 0.0, 0.1] }, { time_s = 14.0, at_m = [0.0, 0.0, 0.1] }, { time_s = 15.0, at_m = [0.0, 0.0, 0.1] }, { time_s = 16.0, at_m = [0.0, 0.0, 0.1] }]",
        message: "hands and cuts make 18 strands of the threads; at most 16 are possible",
        under: "[[thread]]",
        help: "cut it fewer times",
    },
    Slip {
        from: "[[thread.hold]]\ntime_s = 1.0\nend = \"tail\"\n",
        to: "[[thread.hold]]\ntime_s = 1.0\nend = \"tail\"\n[[thread.hold]]\ntime_s = 1.2\nend = \"span\"\nat_m = [0.0, 0.0, 1.0]\n[[thread.hold]]\ntime_s = 1.2\nend = \"span\"\nat_m = [0.0, 0.0, 2.0]\n[[thread.hold]]\ntime_s = 1.2\nend = \"span\"\nat_m = [0.0, 0.0, 3.0]\n[[thread.hold]]\ntime_s = 1.2\nend = \"span\"\nat_m = [0.0, 0.0, 4.0]\n[[thread.hold]]\ntime_s = 1.2\nend = \"span\"\nat_m = [0.0, 0.0, 5.0]\n",
        message: "6 hands between the ends of threads; at most 4 are possible",
        under: "[[thread]]",
        help: "it lets go of the one that it had",
    },
    Slip {
        from: "end = \"tail\"\nknot = true",
        to: "end = \"tip\"\nknot = true",
        message: "unknown value `tip`",
        under: "\"tip\"",
        help: "`tail`, `head`",
    },
    Slip {
        from: "end = \"tail\"\nknot = true",
        to: "end = \"head\"\nknot = true",
        message: "a knot at the head",
        under: "true",
        help: "end = \"tail\"",
    },
    Slip {
        from: "tool = 5",
        to: "tool = 4",
        message: "there is no tool 4",
        under: "4",
        help: "this scene's tools are [2, 5]",
    },
    Slip {
        from: "position_m = [0.0, 0.0, 0.1]",
        to: "",
        message: "tool 5 is nowhere: it cannot hold a thread",
        under: "5",
        help: "position_m",
    },
    Slip {
        from: "time_s = 1.5\nend = \"head\"",
        to: "time_s = 0.5\nend = \"head\"",
        message: "time_s = 0.5: must be at least 1, the time before it",
        under: "0.5",
        help: "do not go back",
    },
    Slip {
        from: "until_s = 3.0",
        to: "until_s = 1.0",
        message: "until_s = 1: must be at least 2",
        under: "1.0",
        help: "do not go back",
    },
    Slip {
        from: "time_s = 4.0\nuntil_s",
        to: "time_s = 2.5\nuntil_s",
        message: "time_s = 2.5: must be at least 3",
        under: "2.5",
        help: "do not go back",
    },
    Slip {
        from: "ratio = 0.2",
        to: "ratio = 1.2",
        message: "ratio = 1.2: must be from 0 to 1",
        under: "1.2",
        help: "draws the punctures together",
    },
    Slip {
        from: "between = [\"left\", \"right\"]",
        to: "between = [\"left\", \"rigth\"]",
        message: "the mesh has no region \"rigth\"",
        under: "\"rigth\"",
        help: "did you mean \"right\"?",
    },
    Slip {
        from: "friction = 0.3",
        to: "friction = nan",
        message: "friction = NaN: must be zero or positive",
        under: "nan",
        help: "Coulomb",
    },
    Slip {
        from: "{ plane = { axis = \"x\", at_m = 0.002 } }",
        to: "{ plane = { axis = \"x\", at_m = -0.022 } }",
        message: "this rim has no node on the boundary of \"right\"",
        under: "{ plane = { axis = \"x\", at_m = -0.022 } }",
        help: "in the order of `between`",
    },
    Slip {
        from: "{ plane = { axis = \"x\", at_m = 0.002 } }",
        to: "{ plane = { axis = \"x\", at_m = 0.0 } }",
        message: "this selection holds no node",
        under: "{ plane = { axis = \"x\", at_m = 0.0 } }",
        help: "the mesh lies in",
    },
];

#[test]
fn slips_are_told_at_their_place() {
    let friction = Slip {
        from: "friction = 0.1",
        to: "friction = 30.0",
        message: "friction = 30: must be between 0 and 10",
        under: "30.0",
        help: "Coulomb's coefficient",
    };
    check_slips(GOOD, &[friction]);
    check_slips(GOOD, SLIPS);
}

#[test]
fn an_end_is_held_by_one_thing() {
    let text = GOOD.replace("knot = true", "knot = true\ntool = 5");
    let Err(SceneError::Flaw(flaw)) = read(&text) else {
        panic!("accepted")
    };
    assert!(
        flaw.to_string().contains("held by several things"),
        "{flaw}"
    );
}

#[test]
fn a_grip_that_holds_a_thread_is_not_idle() {
    let text = GOOD.replace("end = \"head\"\ntool = 5", "end = \"head\"\ntool = 2");
    let scene = read(&text).expect("it only warns");
    let [warning] = scene.warnings.as_slice() else {
        panic!("{:?}", scene.warnings)
    };
    let said = warning.to_string();
    assert!(
        said.contains("tool 5 is a grip that holds no needle and no thread"),
        "{said}"
    );
}

/// The scene without its needles and threads, but with what may touch.
fn without_needles() -> String {
    let (head, tail) = GOOD.split_once("[[needle]]").expect("needles");
    let (_, touching) = tail.split_once("[[tissue_contact]]").expect("contact");
    let head = head.replace("needle = {", "# needle = {");
    [&head, "[[tissue_contact]]", touching].concat()
}

#[test]
fn tissues_touch_without_a_needle() {
    let scene = read(&without_needles()).expect("a good scene");
    assert!(scene.warnings.is_empty(), "{:?}", scene.warnings);
    assert!(scene.needles.is_empty() && scene.depends_on_way());
    let (model, ..) = scene.build().expect("a good model");
    let sources = model.sources.as_ref().expect("a balance of all");
    assert!(sources.needles.is_empty() && sources.touching.is_some());

    let pressing = without_needles().replacen("shape = \"grip\"", "radius_m = 0.01", 1);
    let (model, ..) = read(&pressing)
        .expect("a good scene")
        .build()
        .expect("a good model");
    let sources = model.sources.as_ref().expect("a balance of all");
    assert!(!sources.tools.is_empty() && sources.touching.is_some());
}

#[test]
fn handles_hold_tissue_beside_needles() {
    let handle = "[[handle]]\nvertices = [40]\nbarycentric = [1.0]\ntarget_displacement_m = [0.0, 0.0, 0.001]\n";
    for model in ["linear", "corotational", "hyperelastic"] {
        let text = [GOOD, handle].concat();
        let text = text.replace("[tissue]\n", &format!("[tissue]\nmodel = \"{model}\"\n"));
        let scene = read(&text).expect("a good scene");
        let (model, state, _) = scene.build().expect("a good model");
        let rest = model.equilibrium(&state).expect("a balance");
        assert!((rest.displacement_m[40][2] - 0.001).abs() < 1e-9);
        assert_eq!(rest.handle_force_n.len(), 1);
        assert!(
            rest.handle_force_n[0][2] > 0.01,
            "{:?}",
            rest.handle_force_n
        );
        assert!(rest.residual < 1e-8, "{}", rest.residual);
    }
}

/// With bodies that its thread lies on.
fn with_bodies(sections: &str) -> String {
    let body = "id = 5\nshape = \"grip\"\nbody = { radius_m = 0.002, length_m = 0.03 }";
    let text = GOOD.replacen("id = 5\nshape = \"grip\"", body, 1);
    let needle = "thickness_m = 0.0008\nbody = true";
    text.replacen("thickness_m = 0.0008", needle, 1) + sections
}

const BODIES: &str = "\n[[body_contact]]\nbetween = [{ thread = 0 }, { tool = 5 }]\n\
                      [[body_contact]]\nbetween = [{ needle = 3 }, { thread = 0 }]\n";

#[test]
fn bodies_that_threads_lie_on_are_named() {
    let scene = read(&with_bodies(BODIES)).expect("good");
    let contact = |with| ThreadContact { thread: 0, with };
    let named = [ThreadBody::Grip(5), ThreadBody::Needle(3)].map(contact);
    assert_eq!(scene.body_contacts, named);
    scene.build().expect("a model");
    let good = read(GOOD).expect("good");
    assert!(good.body_contacts.is_empty() && good.body_pairs.is_empty());
    let pair = "\n[[body_contact]]\nbetween = [{ tool = 5 }, { needle = 3 }]\nfriction = 0.2\n";
    let scene = read(&with_bodies(pair)).expect("good");
    let [pair] = scene.body_pairs[..] else {
        panic!("one pair");
    };
    assert_eq!(pair.between, [ThreadBody::Grip(5), ThreadBody::Needle(3)]);
    assert_eq!((pair.stiffness_n_per_m, pair.friction), (1000.0, 0.2));
    scene.build().expect("a model");
}

/// A needle that another tool holds is pressed on, and one that nobody does; one that the body's own tool holds is not.
#[test]
fn needles_that_a_body_does_not_press_on_are_told() {
    let pair = "\n[[body_contact]]\nbetween = [{ needle = 3 }, { tool = 5 }]\n";
    let text = with_bodies(pair);
    let said = |hold: &str| {
        let held = text.replacen("time_s = 0.0\ntool = 2", hold, 1);
        let scene = read(&held).expect("good");
        let words = scene.warnings.iter().map(ToString::to_string);
        words
            .filter(|word| word.contains("not press"))
            .collect::<Vec<_>>()
    };
    for hold in [
        "time_s = 0.0\ntool = 2",
        "time_s = 0.0\ntool = 2\n[[needle.hold]]\ntime_s = 0.7",
    ] {
        assert!(said(hold).is_empty());
    }
    assert_eq!(
        said("time_s = 0.0\ntool = 5"),
        ["from 0 s on tool 5 itself holds needle 3: its body does not press on that meanwhile"]
    );
}

#[test]
fn slips_at_bodies_are_told_at_their_place() {
    let slip = |from, to, message, under, help| Slip {
        from,
        to,
        message,
        under,
        help,
    };
    let slips = [
        slip(
            "{ tool = 5 }",
            "{ tool = 6 }",
            "there is no tool 6",
            "{ tool = 6 }",
            "this scene's tools are [2, 5]",
        ),
        slip(
            "{ tool = 5 }",
            "{ tool = 2 }",
            "tool 2 has no body",
            "{ tool = 2 }",
            "add `body = {",
        ),
        slip(
            "{ tool = 5 }",
            "{ thread = 0 }",
            "two threads",
            "{ thread = 0 }",
            "name a thread and a body",
        ),
        slip(
            "[{ thread = 0 }, { tool = 5 }]",
            "[{ tool = 5 }, { tool = 5 }]",
            "a body does not press on itself",
            "{ tool = 5 }",
            "name two",
        ),
        slip(
            "[{ thread = 0 }, { tool = 5 }]",
            "[{ needle = 3 }, { needle = 3 }]",
            "a body does not press on itself",
            "{ needle = 3 }",
            "name two",
        ),
        slip(
            "{ tool = 5 }]",
            "{ tool = 5 }]\nfriction = 0.1",
            "a thread slides on a body: `friction` has no use here",
            "0.1",
            "name two bodies",
        ),
        slip(
            "[{ thread = 0 }, { tool = 5 }]",
            "[{ needle = 3 }, { tool = 5 }]\nstiffness_n_per_m = 1e6",
            "`stiffness_n_per_m` is 1000000; it must be from 1 to 10000",
            "1e6",
            "leave `stiffness_n_per_m` out",
        ),
        slip(
            "[{ thread = 0 }",
            "[{ thread = 1 }",
            "there is no thread 1",
            "{ thread = 1 }",
            "this scene's threads are [0]",
        ),
        slip(
            "{ needle = 3 }",
            "{ needle = 0 }",
            "there is no needle 0",
            "{ needle = 0 }",
            "this scene's needles are [3]",
        ),
        slip(
            "body = true",
            "body = false",
            "needle 3 has no body",
            "{ needle = 3 }",
            "add `body = true`",
        ),
        slip(
            "{ tool = 5 }",
            "{ tol = 5 }",
            "unknown",
            "tol",
            "did you mean `tool`",
        ),
    ];
    check_slips(&with_bodies(BODIES), &slips);
    let twice = with_bodies(&[BODIES, &BODIES.replace("needle = 3", "tool = 5")].concat());
    let message = read(&twice).expect_err("twice").to_string();
    assert!(
        message.contains("thread 0 is to lie on this twice"),
        "{message}"
    );
}

/// Flaws that only building the solver finds are told at the section that they are about.
#[test]
fn errors_of_parts_have_their_place() {
    let scene = read(GOOD).expect("good");
    let at = |error: ModelError| match scene.placed(error) {
        SceneError::Flaw(flaw) => {
            let span = flaw.span();
            GOOD[span.offset()..].lines().next().map(str::to_owned)
        }
        _ => None,
    };
    let flaw = || "wrong".to_owned();
    let number = |id| ThreadError::Number {
        id,
        what: "friction",
        value: 30.0,
        rule: "from 0 to 10",
    };
    for (error, line) in [
        (
            ModelError::Tool {
                id: 5,
                flaw: flaw(),
            },
            "[[tool]]",
        ),
        (
            ModelError::Bar {
                tool: 2,
                flaw: flaw(),
            },
            "[[tool]]",
        ),
        (
            ModelError::Jaws {
                tool: 5,
                flaw: flaw(),
            },
            "[[tool]]",
        ),
        (ModelError::TooManyTools(9), "[[tool]]"),
        (
            ModelError::from(NeedleError::Inside { id: 3 }),
            "[[needle]]",
        ),
        (ModelError::from(NeedleError::TooMany(9)), "[[needle]]"),
        (ModelError::from(number(0)), "[[thread]]"),
        (
            ModelError::from(ThreadError::TooManyStrands(99)),
            "[[thread]]",
        ),
        (
            ModelError::from(TouchError::NoFaces { part: 1 }),
            "[[tissue_contact]]",
        ),
        (ModelError::from(TissueError::AllFixed(9)), "mesh.part]]"),
        (
            ModelError::from(NeedleError::Property {
                what: "cutting_pa",
                value: -1.0,
            }),
            "20e3",
        ),
    ] {
        let said = error.to_string();
        assert_eq!(at(error).as_deref(), Some(line), "{said}");
    }
    assert_eq!(at(ModelError::from(TissueError::Stopped)), None);
}
