//! The same bits on every machine: one committed hash over a trace that leaves nothing out.

#![allow(clippy::unwrap_used, reason = "a test")]

use sutura_hil::NativeConsole;
use sutura_hil::identity_trace::{Committed, Coverage, IdentityTrace, committed, run};
use sutura_shared::control::CODE;
use sutura_shared::device::{DeviceDescription, Joint, Kinematics};
use sutura_shared::wire::faults;

/// Any device to boot with: the script brings its own.
fn boot_device(max_force_n: f32) -> DeviceDescription {
    let joint = Joint {
        counts_per_unit: 1e4,
        zero_counts: 0,
        effort_per_amp: 1.0,
        max_current_a: 1.0,
        max_slew_per_s: 100.0,
        max_speed_per_s: 1.0,
        inertia: 1.0,
        damping: 1.0,
        coulomb: 0.0,
    };
    DeviceDescription {
        name: [0; 16],
        kinematics: Kinematics::Cartesian {
            origin_m: [max_force_n; 3],
        },
        joints: [joint; 3],
        gravity_mass_kg: [0.0; 3],
        max_force_n,
        max_power_w: 1.0,
        max_grip_speed_m_per_s: 1.0,
        actuation_delay_us: 0,
    }
}

fn native(max_force_n: f32) -> IdentityTrace {
    run(&mut NativeConsole::new(&boot_device(max_force_n)).unwrap()).unwrap()
}

#[test]
fn the_native_console_comes_to_the_committed_hash() {
    let trace = native(1.0);
    println!("{:016x} {:?}", trace.hash, trace.coverage);
    let known = committed().last().unwrap();
    assert_eq!(
        trace.hash, known.hash,
        "{:016x}: a change of what the console computes; if it is meant, raise `sutura_shared::control::CODE` and add \
         a line to tests/golden/identity-trace.txt",
        trace.hash
    );
}

/// What recordings say of the code that they were made by is worth as much as this: a new hash has a new number.
#[test]
fn every_committed_hash_has_a_code_of_its_own() {
    let text = include_str!("../../tests/golden/identity-trace.txt");
    let lines = text.lines().filter(|line| !line.starts_with('#')).count();
    let known: Vec<Committed> = committed().collect();
    assert_eq!(known.len(), lines, "a line that cannot be read");
    for (place, one) in (1u32..).zip(&known) {
        assert_eq!(one.code, place, "codes count from 1, one by one");
    }
    for (place, one) in known.iter().enumerate() {
        let again = known[..place].iter().find(|other| other.hash == one.hash);
        assert_eq!(again, None, "the same bits as code {}", one.code);
    }
    assert_eq!(
        known.last().map(|one| one.code),
        Some(CODE),
        "`sutura_shared::control::CODE` is the newest line's"
    );
}

#[test]
fn the_trace_does_not_depend_on_what_the_console_was_before() {
    assert_eq!(native(1.0), native(2.0));
}

#[test]
fn the_trace_leaves_nothing_out() {
    let Coverage {
        states,
        modes,
        faults: seen,
        subnormals,
        negative_zeros,
        swaps,
        decaying_forces,
        let_down,
        recoveries,
    } = native(1.0).coverage;
    assert!(states >= 10_000, "{states}");
    assert!(modes.iter().all(|ticks| *ticks >= 2), "{modes:?}");
    assert!(modes[2] >= 5_000, "{modes:?}");
    assert_eq!(
        seen,
        faults::E_STOP | faults::ENCODER_JUMP | faults::OUT_OF_REACH | faults::OVERSPEED
    );
    assert!(subnormals >= 50, "{subnormals}");
    assert!(negative_zeros >= 5, "{negative_zeros}");
    assert!(swaps >= 500, "{swaps}");
    assert!(decaying_forces >= 50, "{decaying_forces}");
    assert!(let_down >= 50, "{let_down}");
    assert!(recoveries >= 6, "{recoveries}");
}
