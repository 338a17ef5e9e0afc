//! The same bits on every machine: one committed hash over a trace that leaves nothing out.

#![allow(clippy::unwrap_used, reason = "a test")]

use sutura_hil::NativeConsole;
use sutura_hil::identity_trace::{Coverage, IdentityTrace, run};
use sutura_shared::device::{DeviceDescription, Joint, Kinematics};
use sutura_shared::wire::faults;

/// The hash that every console must come to; see the file for how it came about.
fn golden() -> u64 {
    let text = include_str!("../../tests/golden/identity-trace.txt");
    let mut lines = text.lines().filter(|line| !line.starts_with('#'));
    u64::from_str_radix(lines.next().unwrap(), 16).unwrap()
}

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
    assert_eq!(
        trace.hash,
        golden(),
        "{:016x}: a change of what the console computes; if it is meant, change the golden file",
        trace.hash
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
    assert!(recoveries >= 6, "{recoveries}");
}
