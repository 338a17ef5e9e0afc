//! What files beside the library say of it. That there is a test here has `cargo test` build the library.

use std::path::Path;

fn table(path: &str) -> toml::Table {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(path);
    let text = std::fs::read_to_string(path).expect("readable");
    text.parse().expect("TOML")
}

/// The library is for every Python from one on, and pip installs it from that one on.
#[test]
fn pip_and_the_library_begin_with_the_same_python() {
    let project = table("pyproject.toml");
    let least = project["project"]["requires-python"]
        .as_str()
        .expect("text");
    let minor: u32 = least
        .strip_prefix(">=3.")
        .and_then(|minor| minor.parse().ok())
        .expect("a version");
    let workspace = table("../Cargo.toml");
    let features = workspace["workspace"]["dependencies"]["pyo3"]["features"]
        .as_array()
        .expect("a list");
    let abi = format!("abi3-py3{minor}");
    assert!(
        features
            .iter()
            .any(|feature| feature.as_str() == Some(&abi)),
        "{features:?}"
    );
}
