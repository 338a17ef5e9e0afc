//! Every scene and device that ships is good as it stands.

use std::path::{Path, PathBuf};
use sutura_host::scene::{Document, load, read_device};
use sutura_shared::control::Control;

fn toml_files(folder: &str) -> Vec<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let list = std::fs::read_dir(root.join(folder)).expect("the folder is there");
    let paths = list.map(|entry| entry.expect("readable").path());
    paths
        .filter(|path| path.extension().is_some_and(|e| e == "toml"))
        .collect()
}

fn stem(path: &Path) -> String {
    path.file_stem()
        .expect("a file")
        .to_string_lossy()
        .into_owned()
}

#[test]
fn every_scene_loads_without_a_warning() {
    let scenes = toml_files("scenes");
    assert!(scenes.iter().any(|path| stem(path) == "palpation"));
    for path in scenes {
        let scene = load(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        assert!(
            scene.warnings.is_empty(),
            "{}: {:?}",
            path.display(),
            scene.warnings
        );
    }
}

/// A device file's name is the device's name, and the console's own control takes it.
#[test]
fn every_device_reads_and_is_taken_by_the_console() {
    let devices = toml_files("devices");
    assert!(devices.len() >= 2);
    for path in devices {
        let document = Document::read(&path).expect("readable");
        let device = read_device(&document).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        let device = device.description;
        assert_eq!(&device.name[..stem(&path).len()], stem(&path).as_bytes());
        assert!(Control::new(device).is_ok(), "{}", path.display());
    }
}
