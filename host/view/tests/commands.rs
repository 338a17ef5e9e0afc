//! Commands are understood to the last key, or not at all.

use serde_json::json;
use sutura_view::{Command, First, Hand, SetTo};

/// One of each, as clients write them.
fn samples() -> Vec<(String, Command)> {
    let each = [
        (
            json!({"id": 1, "do": "ack", "sequence": 4}),
            Command::Ack(4),
        ),
        (
            json!({"id": 1, "do": "picture_hz", "hz": 24.5}),
            Command::PictureHz(24.5),
        ),
        (
            json!({"id": 1, "do": "scalar", "name": "von-mises"}),
            Command::Scalar(Some("von-mises".to_owned())),
        ),
        (
            json!({"id": 1, "do": "scalar", "name": null}),
            Command::Scalar(None),
        ),
        (json!({"id": 1, "do": "take_control"}), Command::TakeControl),
        (json!({"id": 1, "do": "safe_stop"}), Command::SafeStop),
        (json!({"id": 1, "do": "arm"}), Command::Arm),
        (json!({"id": 1, "do": "clear_fault"}), Command::ClearFault),
        (json!({"id": 1, "do": "take_out"}), Command::TakeOut),
        (
            json!({"id": 1, "do": "drag", "to_m": [0.01, -0.02, 0.03]}),
            Command::Drag(Some([0.01, -0.02, 0.03])),
        ),
        (
            json!({"id": 1, "do": "drag", "to_m": null}),
            Command::Drag(None),
        ),
        (
            json!({"id": 1, "do": "hand", "way": "scene"}),
            Command::Hand(Hand::Scene),
        ),
        (
            json!({"id": 1, "do": "hand", "way": "recorded"}),
            Command::Hand(Hand::Recorded),
        ),
        (json!({"id": 1, "do": "pause"}), Command::Pause),
        (json!({"id": 1, "do": "resume"}), Command::Resume),
        (
            json!({"id": 1, "do": "step", "ticks": 10}),
            Command::StepTicks(10),
        ),
        (
            json!({"id": 1, "do": "step", "solves": 1}),
            Command::StepSolves(1),
        ),
        (
            json!({"id": 1, "do": "speed", "factor": 0.1}),
            Command::Speed(0.1),
        ),
        (json!({"id": 1, "do": "reset"}), Command::Reset),
        (
            json!({"id": 1, "do": "scene", "name": "tubes"}),
            Command::Scene("tubes".to_owned()),
        ),
        (
            json!({"id": 1, "do": "tissue", "name": "linear"}),
            Command::Tissue("linear".to_owned()),
        ),
        (
            json!({"id": 1, "do": "set", "name": "host-hz", "value": 100}),
            Command::Set {
                name: "host-hz".to_owned(),
                value: SetTo::Number(100.0),
            },
        ),
        (
            json!({"id": 1, "do": "set", "name": "rendering", "value": "hold"}),
            Command::Set {
                name: "rendering".to_owned(),
                value: SetTo::Word("hold".to_owned()),
            },
        ),
        (
            json!({"id": 1, "do": "record", "on": true}),
            Command::Record(true),
        ),
        (
            json!({"id": 1, "do": "jaws", "closed": true}),
            Command::Jaws(true),
        ),
        (json!({"id": 1, "do": "save_last"}), Command::SaveLast),
        (
            json!({"id": 1, "do": "seek", "time_s": 1.25}),
            Command::Seek(1.25),
        ),
    ];
    each.into_iter()
        .map(|(text, command)| (text.to_string(), command))
        .collect()
}

#[test]
fn every_command_is_understood() {
    for (text, command) in samples() {
        assert_eq!(Command::read(&text), Ok((1, command)), "{text}");
    }
    let ack = Command::read("{\"do\":\"ack\",\"sequence\":9}");
    assert_eq!(ack, Ok((0, Command::Ack(9))));
}

#[test]
fn what_is_not_quite_a_command_is_refused_with_its_id() {
    for (text, id) in [
        (json!({"id": 3, "do": "pause", "ticks": 1}), 3),
        (json!({"id": 3, "do": "step"}), 3),
        (json!({"id": 3, "do": "step", "ticks": 0}), 3),
        (json!({"id": 3, "do": "step", "ticks": 1.5}), 3),
        (json!({"id": 3, "do": "step", "ticks": 1, "solves": 1}), 3),
        (json!({"id": 3, "do": "speed", "factor": 0}), 3),
        (json!({"id": 3, "do": "speed", "factor": "1"}), 3),
        (json!({"id": 3, "do": "drag"}), 3),
        (json!({"id": 3, "do": "drag", "to_m": [0, 0]}), 3),
        (json!({"id": 3, "do": "drag", "to_m": [0, 0, 11]}), 3),
        (json!({"id": 3, "do": "drag", "to_m": [0, 0, null]}), 3),
        (json!({"id": 3, "do": "hand", "way": "other"}), 3),
        (json!({"id": 3, "do": "set", "name": "host-hz"}), 3),
        (
            json!({"id": 3, "do": "set", "name": "host-hz", "value": null}),
            3,
        ),
        (json!({"id": 3, "do": "record"}), 3),
        (json!({"id": 3, "do": "record", "on": 1}), 3),
        (
            json!({"id": 3, "do": "record", "on": true, "file": "a.mcap"}),
            3,
        ),
        (json!({"id": 3, "do": "save_last", "file": "a.mcap"}), 3),
        (json!({"id": 3, "do": "Pause"}), 3),
        (json!({"id": 3}), 3),
        (json!({"do": "pause"}), 0),
        (json!({"id": -1, "do": "pause"}), 0),
        (json!({"id": 1e300, "do": "pause"}), 0),
        (json!([1, 2]), 0),
    ] {
        let refused = Command::read(&text.to_string()).expect_err(&text.to_string());
        assert_eq!(refused.id, id, "{text}");
        assert!(!refused.message.is_empty() && !refused.help.is_empty());
    }
}

/// A hundred thousand messages that are nearly commands: none panics, and what is understood says the same when it is
/// written anew.
#[test]
fn mutated_messages_are_refused_or_mean_what_they_say() {
    let mut random = fastrand::Rng::with_seed(8421);
    let samples = samples();
    let first = json!({"key": "0123", "control": true, "format": 1}).to_string();
    let (mut understood, mut refused) = (0, 0);
    for _ in 0..100_000 {
        let (text, _) = &samples[random.usize(..samples.len())];
        let mut bytes = text.clone().into_bytes();
        for _ in 0..random.usize(1..4) {
            let place = random.usize(..bytes.len());
            match random.u8(..5) {
                0 => bytes[place] = random.u8(..),
                1 => {
                    bytes.remove(place);
                }
                2 => bytes.insert(place, b"0123456789-e.\"{}[],:n"[random.usize(..21)]),
                3 => {
                    let (other, _) = &samples[random.usize(..samples.len())];
                    let cut = random.usize(..other.len());
                    bytes.truncate(place);
                    bytes.extend_from_slice(&other.as_bytes()[cut..]);
                }
                _ => {
                    let copy = bytes[place..].to_vec();
                    bytes.extend_from_slice(&copy);
                }
            }
            if bytes.is_empty() {
                bytes.push(b'{');
            }
        }
        let text = String::from_utf8_lossy(&bytes);
        // It takes the key for nothing else.
        assert!(First::read(&text).is_none_or(|first| first.format < 100));
        match Command::read(&text) {
            Err(_) => refused += 1,
            Ok((id, command)) => {
                understood += 1;
                assert!(id <= 1 << 53);
                match command {
                    Command::PictureHz(hz) => assert!((0.0..=60.0).contains(&hz)),
                    Command::Speed(factor) => assert!((0.01..=4.0).contains(&factor)),
                    Command::StepTicks(ticks) => assert!((1..=10_000).contains(&ticks)),
                    Command::StepSolves(solves) => assert!((1..=1000).contains(&solves)),
                    Command::Drag(Some(to_m)) => assert!(to_m.iter().all(|x| x.abs() <= 10.0)),
                    Command::Set {
                        value: SetTo::Number(value),
                        ..
                    } => assert!(value.is_finite()),
                    Command::Seek(time_s) => assert!((0.0..=1e9).contains(&time_s)),
                    _ => {}
                }
            }
        }
    }
    assert!(First::read(&first).is_some());
    assert!(
        understood > 1000 && refused > 50_000,
        "{understood} understood, {refused} refused"
    );
}
