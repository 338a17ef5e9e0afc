//! The page's format: golden bytes that the page's own tests read too, and how far off quantised values are.

use proptest::prelude::*;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use sutura_host::picture::{
    Boundary, NeedleView, Picture, Read, Scalar, SolveRow, SolvesOf, StatusView, ThreadPointView,
    ThreadView, TickRow, ToolView, encode_solves, encode_ticks,
};
use sutura_host::recording::SolveSample;
use sutura_shared::wire::message::{Mode, State};

/// Set to write the files anew, after a change of the format and its page.
const WRITE: &str = "SUTURA_WRITE_GOLDEN";

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/golden/view")
}

/// Two cells on each other, the lower one's bottom fixed, of two regions.
fn boundary() -> Boundary {
    let points_m = vec![
        [0.0, 0.0, 0.0],
        [0.02, 0.0, 0.0],
        [0.0, 0.02, 0.0],
        [0.005, 0.005, 0.015],
        [0.02, 0.02, 0.02],
    ];
    let cells = vec![[0, 1, 2, 3], [1, 4, 2, 3]];
    let mesh = sutura_host::mesh::RawMesh::new(points_m, cells, vec![1, -2]);
    Boundary::of(&mesh.check().expect("a mesh"), &[0, 1, 2], 7)
}

fn picture() -> Picture {
    Picture {
        sequence: 41,
        recorded: true,
        withheld: true,
        time_s: 1.25,
        console_time_us: 3_250_017,
        solves: 312,
        geometry: 7,
        displacement_m: vec![
            [0.0, 0.0, 0.0],
            [1e-3, -2e-3, 0.5e-3],
            [0.0, 0.25e-3, 0.0],
            [-1.5e-3, 0.0, -0.125e-3],
            [0.0, 0.0, 2e-3],
        ],
        scalar: Some((Scalar::VonMises, vec![120.0, 0.0, 980.5, 333.25, 1000.0])),
        tools: vec![
            ToolView {
                id: 3,
                driven: true,
                position_m: [0.01, 0.02, 0.0305],
                orientation: [0.0, 0.6, 0.0, 0.8],
                wrench: [0.5, -0.25, 1.5, 0.001, 0.002, -0.003],
                gap_m: 0.0,
                rows: 9,
            },
            ToolView {
                id: 4,
                orientation: [0.0, 0.0, 0.0, 1.0],
                gap_m: f64::MAX,
                ..ToolView::default()
            },
        ],
        needles: vec![NeedleView {
            id: 1,
            tip: 2,
            held_by: None,
            position_m: [0.001, 0.002, 0.003],
            orientation: [1.0, 0.0, 0.0, 0.0],
            crossings: 12,
            punctures: 2,
            axial_n: -0.75,
            hold_n: 0.125,
            puncture_n: f64::INFINITY,
        }],
        threads: vec![
            ThreadView {
                id: 2,
                state: 1,
                points: vec![
                    ThreadPointView {
                        at_m: [0.01, 0.0, 0.02],
                        what: 0,
                        tension_n: 0.5,
                    },
                    ThreadPointView {
                        at_m: [0.012, 0.001, 0.018],
                        what: 2,
                        tension_n: 0.25,
                    },
                    ThreadPointView {
                        at_m: [0.013, -0.004, 0.01],
                        what: 3,
                        tension_n: 0.0,
                    },
                ],
            },
            ThreadView {
                id: 5,
                state: 0,
                points: vec![
                    ThreadPointView::default(),
                    ThreadPointView {
                        at_m: [0.0, 0.0, 1.0],
                        what: 5,
                        ..ThreadPointView::default()
                    },
                ],
            },
        ],
        contacts: vec![(3, [0.0, 0.0, -0.5]), (4, [0.125, 0.0, -1.0])],
        status: StatusView {
            word: 5,
            touches: true,
            rows: 9,
            touching: 4,
            iterations: 6,
            residual: 1e-6,
            energy_j: 0.0025,
            tension_n: Some(0.5),
            bridge_ratio: None,
            grip_m: [0.01, 0.02, 0.04],
        },
    }
}

fn state(tick: u32) -> State {
    let at = tick as f32;
    State {
        tick,
        position_m: [0.001 * at, 0.002, 0.003],
        orientation: [0.0, 0.0, 0.0, 1.0],
        velocity_m_per_s: [0.0, 0.0625 * at, 0.0],
        force_n: [0.0, 0.0, 0.5 * at],
        current_a: [0.0; 3],
        mode: if tick == 2 {
            Mode::Decaying
        } else {
            Mode::Armed
        },
        faults: if tick == 3 { 0x41 } else { 0 },
        contact_sequence: 1,
        contact_age_us: if tick == 1 { u32::MAX } else { 4000 + tick },
        applied_age_us: 3000 + tick,
        trace_hash: 1,
        encoder_counts: [0; 3],
        inputs: 0x80,
        heard_sequence: 0,
    }
}

fn ticks() -> Vec<TickRow> {
    let row = |tick| TickRow {
        time_s: 0.001 * f64::from(tick),
        state: state(tick),
    };
    (1..=3).map(row).collect()
}

fn solves() -> Vec<SolveRow> {
    let sample = |status: &str, wrench, gap_m| SolveSample {
        console_time_us: 1000,
        status: status.to_owned(),
        state_hash: String::new(),
        wrench,
        gap_m,
        rows: 4,
        console_rows: 4,
        step_us: 812.5,
        arrivals: Vec::new(),
        looked: Default::default(),
        tuned: None,
        acts: Vec::new(),
        stages_us: vec![0.0, 1.0, 2.0, 3.0, 500.0, 5.0, 6.0, 7.0, 8.0],
        iterations: 11,
        energy_j: 0.125,
        axial_n: vec![-0.5],
        tension_n: vec![0.25, 0.75],
        punctures: 1,
    };
    vec![
        SolveRow {
            time_s: 0.0,
            sample: sample("ok", Some([1.0, 2.0, 3.0, 0.1, 0.2, 0.3]), Some(0.0)),
        },
        SolveRow {
            time_s: 0.004,
            sample: sample("not-converged", None, None),
        },
    ]
}

const OF: SolvesOf = SolvesOf {
    session: 9,
    needles: 1,
    threads: 1,
};

/// Values as JSON has them: what is no number is null, what is infinite a text.
fn number(value: f64) -> Value {
    if value.is_nan() {
        Value::Null
    } else if value.is_infinite() {
        json!("infinity")
    } else {
        json!(value)
    }
}

fn numbers(values: impl IntoIterator<Item = f64>) -> Value {
    values.into_iter().map(number).collect()
}

fn messages() -> Vec<(&'static str, Vec<u8>, Value)> {
    let (boundary, picture) = (boundary(), picture());
    let mut all = Vec::new();
    let mut bytes = Vec::new();
    boundary.encode(9, &mut bytes);
    all.push((
        "geometry",
        bytes.clone(),
        json!({
            "kind": 1, "geometry": 7, "session": 9, "mesh_nodes": 5,
            "points_m": boundary.points_m, "triangles": boundary.triangles,
            "regions": boundary.regions, "fixed": boundary.fixed, "nodes": boundary.nodes,
        }),
    ));
    picture.encode(&mut bytes);
    let tools = picture.tools.iter().map(|tool| {
        json!({
            "id": tool.id, "driven": tool.driven, "position_m": tool.position_m, "orientation": tool.orientation,
            "wrench": tool.wrench, "gap_m": number(if tool.gap_m > 1e3 { f64::INFINITY } else { tool.gap_m }), "rows": tool.rows,
        })
    });
    let needles = picture.needles.iter().map(|needle| {
        json!({
            "id": needle.id, "tip": needle.tip, "held_by": needle.held_by, "position_m": needle.position_m,
            "orientation": needle.orientation, "crossings": needle.crossings, "punctures": needle.punctures,
            "axial_n": needle.axial_n, "hold_n": needle.hold_n, "puncture_n": number(needle.puncture_n),
        })
    });
    let threads = picture.threads.iter().map(|thread| {
        let points = thread.points.iter();
        let points =
            points.map(|p| json!({"at_m": p.at_m, "what": p.what, "tension_n": p.tension_n}));
        json!({"id": thread.id, "state": thread.state, "points": points.collect::<Value>()})
    });
    let contacts = picture.contacts.iter();
    let contacts = contacts.map(|(vertex, force_n)| json!({"vertex": vertex, "force_n": force_n}));
    let status = picture.status;
    let (scalar, values) = picture.scalar.clone().expect("a scalar");
    all.push((
        "picture",
        bytes.clone(),
        json!({
            "kind": 2, "sequence": picture.sequence, "recorded": true, "withheld": true, "time_s": picture.time_s,
            "console_time_us": picture.console_time_us, "solves": picture.solves, "geometry": picture.geometry,
            "displacement_m": picture.displacement_m, "displacement_scale_m": 2e-3,
            "scalar": scalar.number(), "scalar_low": 0.0, "scalar_high": 1000.0, "scalar_values": values,
            "tools": tools.collect::<Value>(), "needles": needles.collect::<Value>(),
            "threads": threads.collect::<Value>(), "contacts": contacts.collect::<Value>(),
            "status": {
                "word": status.word, "touches": status.touches, "rows": status.rows, "touching": status.touching,
                "iterations": status.iterations, "residual": status.residual, "energy_j": status.energy_j,
                "tension_n": status.tension_n, "bridge_ratio": status.bridge_ratio, "grip_m": status.grip_m,
            },
        }),
    ));
    let rows = ticks();
    encode_ticks(9, &rows, &mut bytes);
    let states = || rows.iter().map(|row| row.state);
    // Widened, as a reader sees them: with some features `serde_json` shows an `f32` by fewer digits.
    let vectors = |of: fn(&State) -> [f32; 3]| -> Value {
        states()
            .map(|state| json!(of(&state).map(f64::from)))
            .collect()
    };
    all.push((
        "ticks",
        bytes.clone(),
        json!({
            "kind": 3, "session": 9, "gap": false, "count": rows.len(),
            "time_s": numbers(rows.iter().map(|row| row.time_s)),
            "tick": states().map(|s| s.tick).collect::<Vec<_>>(),
            "position_m": vectors(|s| s.position_m), "velocity_m_per_s": vectors(|s| s.velocity_m_per_s),
            "force_n": vectors(|s| s.force_n),
            "age_us": states().map(|s| s.contact_age_us).collect::<Vec<_>>(),
            "applied_age_us": states().map(|s| s.applied_age_us).collect::<Vec<_>>(),
            "mode": states().map(|s| s.mode as u8).collect::<Vec<_>>(),
            "inputs": states().map(|s| s.inputs).collect::<Vec<_>>(),
            "faults": states().map(|s| s.faults).collect::<Vec<_>>(),
        }),
    ));
    let rows = solves();
    encode_solves(OF, &rows, &mut bytes);
    let samples = || rows.iter().map(|row| &row.sample);
    let stage = |stage: usize| numbers(samples().map(|s| s.stages_us[stage]));
    all.push((
        "solves",
        bytes,
        json!({
            "kind": 4, "session": 9, "gap": false, "count": rows.len(), "stages": 9,
            "time_s": numbers(rows.iter().map(|row| row.time_s)),
            "status": [0, 5],
            "step_us": numbers(samples().map(|s| s.step_us)),
            "stages_us": (0..9).map(stage).collect::<Value>(),
            "rows": samples().map(|s| s.rows).collect::<Vec<_>>(),
            "gap_m": numbers(samples().map(|s| s.gap_m.unwrap_or(f64::INFINITY))),
            "wrench": samples().map(|s| numbers(s.wrench.unwrap_or([f64::NAN; 6]))).collect::<Value>(),
            "iterations": samples().map(|s| s.iterations).collect::<Vec<_>>(),
            "energy_j": numbers(samples().map(|s| s.energy_j)),
            "axial_n": [numbers(samples().map(|s| s.axial_n[0]))],
            "tension_n": [[numbers(samples().map(|s| s.tension_n[0])), numbers(samples().map(|s| s.tension_n[1]))]],
        }),
    ));
    all
}

/// What is written is read back; what is cut short, of another format or of another kind is nothing, and no message makes it panic.
#[test]
fn a_picture_is_read_back() {
    let mut bytes = Vec::new();
    picture().encode(&mut bytes);
    let read = Picture::read(&bytes).expect("a picture");
    let mut again = Vec::new();
    read.encode(&mut again);
    assert!(again == bytes, "{read:?}");
    for length in 0..bytes.len() - 8 {
        assert_eq!(Picture::read(&bytes[..length]), None, "{length} bytes");
    }
    let mut other = bytes.clone();
    other[1] += 1;
    assert_eq!(Picture::read(&other), None);
    let mut ticks_bytes = Vec::new();
    encode_ticks(9, &ticks(), &mut ticks_bytes);
    assert_eq!(Picture::read(&ticks_bytes), None);
    let read = Read::of(&ticks_bytes).expect("ticks");
    let rows = ticks();
    let times: Vec<f64> = rows.iter().map(|row| row.time_s).collect();
    let forces: Vec<_> = rows
        .iter()
        .map(|row| row.state.force_n.map(f64::from))
        .collect();
    let modes: Vec<_> = rows.iter().map(|row| row.state.mode as u8).collect();
    assert_eq!(
        (read.kind, read.f64s(1), read.vectors(5)),
        (3, times, forces)
    );
    assert_eq!((read.u8s(8), read.u16s(10)), (modes, vec![0, 0, 0x41]));
    boundary().encode(9, &mut bytes);
    let read = Read::of(&bytes).expect("a geometry");
    assert_eq!(read.triples(2), boundary().triangles);
    let mut random = fastrand::Rng::with_seed(20);
    for _ in 0..20_000 {
        let mut wrong = again.clone();
        for _ in 0..4 {
            let at = random.usize(..wrong.len());
            wrong[at] = random.u8(..);
        }
        let _ = Picture::read(&wrong);
    }
}

/// Bytes and what they hold: as committed, to the byte.
#[test]
fn messages_are_the_golden_bytes() {
    let folder = folder();
    let mut said = serde_json::Map::new();
    let writes = std::env::var_os(WRITE).is_some();
    for (name, bytes, holds) in messages() {
        let path = folder.join(format!("{name}.bin"));
        if writes {
            std::fs::create_dir_all(&folder).expect("a folder");
            std::fs::write(&path, &bytes).expect("written");
        }
        let golden = std::fs::read(&path).expect("a golden file");
        assert!(bytes == golden, "{name} is not {}", path.display());
        said.insert(format!("{name}.bin"), holds);
    }
    let path = folder.join("golden.json");
    if writes {
        let text = serde_json::to_string_pretty(&said).expect("JSON");
        std::fs::write(&path, text + "\n").expect("written");
    }
    let text = std::fs::read_to_string(&path).expect("a golden file");
    let golden: Value = serde_json::from_str(&text).expect("JSON");
    assert_eq!(golden, Value::Object(said));
}

/// Sections of a message by their tags, where the header has `count_at` the number of them; also that they begin at
/// multiples of 8 and fill the message.
fn sections(bytes: &[u8], header: usize, count_at: usize) -> Vec<(u16, &[u8])> {
    let u16_at = |at: usize| u16::from_le_bytes([bytes[at], bytes[at + 1]]);
    let mut at = header;
    let mut found = Vec::new();
    for _ in 0..u16_at(count_at) {
        let length = u32::from_le_bytes(bytes[at + 4..at + 8].try_into().expect("four")) as usize;
        assert_eq!(at % 8, 0);
        found.push((u16_at(at), &bytes[at + 8..at + 8 + length]));
        at = (at + 8 + length).next_multiple_of(8);
    }
    assert_eq!(at, bytes.len(), "sections fill the message");
    found
}

#[test]
fn sections_are_aligned_and_complete() {
    let tags = |name: &str, header, count_at| {
        let all = messages();
        let (_, bytes, _) = all
            .iter()
            .find(|(other, ..)| *other == name)
            .expect("there");
        let found = sections(bytes, header, count_at);
        found
            .iter()
            .map(|(tag, bytes)| (*tag, bytes.len()))
            .collect::<Vec<_>>()
    };
    assert_eq!(
        tags("geometry", 32, 24),
        [(1, 60), (2, 72), (3, 24), (4, 5), (5, 20)]
    );
    assert_eq!(
        tags("picture", 56, 50),
        [
            (1, 30),
            (2, 10),
            (3, 128),
            (4, 56),
            (5, 60),
            (5, 48),
            (6, 32),
            (7, 48)
        ]
    );
    assert_eq!(tags("ticks", 24, 16).len(), 10);
    assert_eq!(tags("solves", 24, 16).len(), 11);
}

fn decoded(picture: &Picture) -> (Vec<f64>, f64) {
    let mut bytes = Vec::new();
    picture.encode(&mut bytes);
    let scale = f64::from(f32::from_le_bytes(bytes[36..40].try_into().expect("four")));
    let all = sections(&bytes, 56, 50);
    let (_, first) = all.iter().find(|(tag, _)| *tag == 1).expect("displacement");
    let values = first.chunks_exact(2).map(|two| {
        let value = i16::from_le_bytes([two[0], two[1]]);
        f64::from(value) * scale / 32767.0
    });
    (values.collect(), scale)
}

proptest! {
    /// No displacement is off by more than half a step of the scale, which is no more than the largest one.
    #[test]
    fn displacement_is_off_by_half_a_step_at_most(
        values in prop::collection::vec((-1.0..1.0_f64, -1.0..1.0_f64, -1.0..1.0_f64), 1..60),
        size in -6.0..1.0_f64,
    ) {
        let size = 10_f64.powf(size);
        let displacement_m: Vec<[f64; 3]> = values.iter().map(|(x, y, z)| [x * size, y * size, z * size]).collect();
        let largest = displacement_m.iter().flatten().fold(0.0_f64, |most, x| most.max(x.abs()));
        let picture = Picture { displacement_m: displacement_m.clone(), ..Picture::default() };
        let (found, scale) = decoded(&picture);
        prop_assert!(scale >= largest && scale <= largest * (1.0 + 1.2e-7));
        for (found, value) in found.iter().zip(displacement_m.iter().flatten()) {
            prop_assert!((found - value).abs() <= scale / 65534.0 * (1.0 + 1e-9), "{found} for {value}");
        }
    }

    /// The same of scalars, between the ends that are said.
    #[test]
    fn scalars_are_off_by_half_a_step_at_most(
        values in prop::collection::vec(-1e6..1e6_f64, 1..60),
    ) {
        let picture = Picture { scalar: Some((Scalar::StressLargest, values.clone())), ..Picture::default() };
        let mut bytes = Vec::new();
        picture.encode(&mut bytes);
        let at = |place: usize| f64::from(f32::from_le_bytes(bytes[place..place + 4].try_into().expect("four")));
        let (low, high) = (at(40), at(44));
        prop_assert!(values.iter().all(|value| (low..=high).contains(value)));
        let all = sections(&bytes, 56, 50);
        let (_, words) = all.iter().find(|(tag, _)| *tag == 2).expect("a scalar");
        for (two, value) in words.chunks_exact(2).zip(&values) {
            let found = low + f64::from(u16::from_le_bytes([two[0], two[1]])) * (high - low) / 65535.0;
            prop_assert!((found - value).abs() <= (high - low) / 131_070.0 * (1.0 + 1e-9), "{found} for {value}");
        }
    }
}

/// What is no number makes no message that a page would choke on, nor a panic.
#[test]
fn what_is_no_number_is_nothing() {
    let picture = Picture {
        displacement_m: vec![[f64::NAN, 1.0, f64::INFINITY]],
        scalar: Some((Scalar::Displacement, vec![f64::NAN])),
        ..Picture::default()
    };
    let mut bytes = Vec::new();
    picture.encode(&mut bytes);
    assert_eq!(sections(&bytes, 56, 50)[0].1.len(), 6);
}
