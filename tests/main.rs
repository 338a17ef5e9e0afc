//! All tests of the command, in one binary: each one more would link the whole solver once more.

mod c_client;
mod cli_bad_input;
mod cli_bench;
mod cli_default;
mod cli_doctor;
mod cli_fidelity;
mod cli_mesh;
#[cfg(unix)]
mod cli_mesh_fill;
mod cli_models;
mod cli_scene;
mod cli_solve;
mod cli_stability;
mod cli_tradeoff;
#[cfg(all(target_os = "linux", feature = "view"))]
mod desktop;
mod earlier_version;
mod endings;
mod fault_scenarios;
mod files;
mod flash;
#[cfg(all(unix, feature = "foxglove"))]
mod foxglove;
mod help_examples;
mod install;
mod interrupted;
mod killed_host;
mod lags;
mod lockstep;
mod messages;
mod model_forces;
mod needles;
mod python_peer;
#[cfg(feature = "qemu-tests")]
mod qemu;
mod replay;
mod rust_client;
mod schemas;
mod series;
mod session_pty;
mod shipped_files;
mod support;
#[cfg(all(target_os = "linux", feature = "top"))]
mod top;
#[cfg(all(unix, feature = "view"))]
mod view;
mod wounds;
mod wrong_peers;
