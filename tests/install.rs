//! The command as it is installed: its version, what shells and `man` know of it, and an emulator's image beside it.

use crate::support::{ran, root, sutura, sutura_in};
use std::path::{Path, PathBuf};
use std::process::Command;
use sutura_testkit::full;

fn git(at: &Path, arguments: &[&str]) -> Option<String> {
    let output = Command::new("git")
        .args(arguments)
        .current_dir(at)
        .output()
        .ok()?;
    let text = String::from_utf8(output.stdout).ok()?;
    output.status.success().then(|| text.trim().to_owned())
}

#[test]
fn the_version_names_the_commit() {
    let said = sutura(&["--version"]).stdout;
    let version = env!("CARGO_PKG_VERSION");
    let here = git(
        &root(),
        &["ls-files", "--error-unmatch", "host/cli/build.rs"],
    )
    .and_then(|_| git(&root(), &["log", "-1", "--format=%h, %cs", "--abbrev=12"]));
    match here {
        Some(commit) => assert_eq!(said, format!("sutura {version} ({commit})\n")),
        None => assert!(said.starts_with(&format!("sutura {version}")), "{said}"),
    }
}

/// What the build script says in a folder that git knows nothing of, as one that was unpacked is.
#[test]
fn a_tarball_says_the_commit_that_git_wrote_into_it() {
    let folder = tempfile::tempdir().expect("a folder");
    let script = folder.path().join("script");
    let built = Command::new("rustc")
        .args(["--edition", "2024", "-o"])
        .arg(&script)
        .arg(root().join("host/cli/build.rs"))
        .env("CARGO_PKG_VERSION", "1.2.3")
        .status();
    assert!(built.expect("rustc is there").success());
    let says = |at: &Path| {
        let output = Command::new(&script)
            .current_dir(at)
            // Folders for tests may be below somebody's checkout.
            .env("GIT_CEILING_DIRECTORIES", folder.path())
            .output()
            .expect("it runs");
        String::from_utf8(output.stdout).expect("text")
    };
    for (text, expected) in [
        (
            Some("0123456789ab, 2026-11-26\n"),
            "1.2.3 (0123456789ab, 2026-11-26)",
        ),
        (Some("$Format:%h, %cs$\n"), "1.2.3"),
        (Some("\n"), "1.2.3"),
        (None, "1.2.3"),
    ] {
        let at = tempfile::tempdir_in(folder.path()).expect("a folder");
        if let Some(text) = text {
            std::fs::write(at.path().join("commit.txt"), text).expect("writable");
        }
        let said = says(at.path());
        assert!(
            said.contains(&format!("SUTURA_VERSION={expected}\n")),
            "{text:?}: {said}"
        );
    }
    // Below a checkout that is not ours its commit is not said.
    let others = tempfile::tempdir_in(folder.path()).expect("a folder");
    if git(others.path(), &["init", "--quiet"]).is_some() {
        let said = says(others.path());
        assert!(said.contains("SUTURA_VERSION=1.2.3\n"), "{said}");
    }
    let attributes = std::fs::read_to_string(root().join(".gitattributes")).expect("there");
    assert!(attributes.contains("host/cli/commit.txt export-subst"));
    let own = std::fs::read_to_string(root().join("host/cli/commit.txt")).expect("there");
    assert!(
        own.starts_with("$Format:%h, %cs$") || !own.contains('$'),
        "{own}"
    );
}

/// No address that is nobody's, and nothing that keeps `cargo install --path host/cli --locked` from working.
#[test]
fn manifests_are_those_of_a_program_to_install() {
    let output = Command::new("cargo")
        .args([
            "metadata",
            "--format-version",
            "1",
            "--locked",
            "--offline",
            "--no-deps",
        ])
        .current_dir(root())
        .output()
        .expect("cargo is there");
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(
        output.status.success(),
        "the lock file is not what manifests ask for: {stderr}"
    );
    let metadata: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let packages = metadata["packages"].as_array().expect("packages");
    for package in packages {
        for key in ["repository", "homepage", "documentation"] {
            assert!(
                package[key].is_null(),
                "{}: {key} = {}",
                package["name"],
                package[key]
            );
        }
    }
    let own = packages
        .iter()
        .find(|package| package["name"] == "sutura")
        .expect("the command");
    let targets = own["targets"].as_array().expect("targets");
    let is_program = |target: &&serde_json::Value| target["kind"][0] == "bin";
    let programs: Vec<_> = targets
        .iter()
        .filter(is_program)
        .map(|target| &target["name"])
        .collect();
    assert_eq!(programs, ["sutura"]);
}

/// As the book's page on installing says, into a folder that was empty; it runs its own scene from anywhere. The page's size is this one's.
#[test]
fn the_command_is_installed_from_the_checkout() {
    if !full() {
        return;
    }
    let folder = tempfile::tempdir().expect("a folder");
    let mut install = Command::new("cargo");
    install.args(["install", "--path", "host/cli", "--locked", "--root"]);
    let installed = ran(install.arg(folder.path()).current_dir(root()));
    assert_eq!(installed.code, 0, "{}", installed.stderr);
    let program = folder.path().join("bin/sutura");
    let megabytes = program.metadata().expect("there").len() as f64 / 1e6;
    println!("{megabytes:.1} MB");
    let page = std::fs::read_to_string(root().join("docs/src/install.md")).expect("readable");
    let said = page
        .split(" MB")
        .next()
        .and_then(|before| before.rsplit(' ').next());
    let said: f64 = said.and_then(|word| word.parse().ok()).expect("a size");
    assert!(
        (megabytes / said - 1.0).abs() < 0.1,
        "{megabytes} MB, not {said}"
    );
    let run = |arguments: &[&str]| {
        ran(Command::new(&program)
            .args(arguments)
            .current_dir(folder.path()))
    };
    assert_eq!(run(&["--version"]).stdout, sutura(&["--version"]).stdout);
    let felt = run(&["run", "--lockstep", "--seconds", "1", "--format", "json"]);
    assert_eq!(felt.code, 0, "{}", felt.stderr);
    assert!(
        felt.json()["force_n"]["peak"].as_f64() > Some(0.3),
        "{}",
        felt.stdout
    );
}

#[test]
fn shells_complete_every_command() {
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let ran = sutura(&["completions", shell]);
        assert_eq!(ran.code, 0, "{shell}: {}", ran.stderr);
        for word in ["tradeoff", "selftest", "console", "schema"] {
            assert!(ran.stdout.contains(word), "{shell} lacks {word}");
        }
    }
    // A shell that reads it finds nothing wrong.
    let script = sutura(&["completions", "bash"]).stdout;
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("sutura.bash");
    std::fs::write(&file, script).expect("writable");
    if let Ok(status) = Command::new("bash").arg("-n").arg(&file).status() {
        assert!(status.success());
    }
}

#[test]
fn every_command_has_a_manual_page() {
    let folder = tempfile::tempdir().expect("a folder");
    let ran = sutura_in(folder.path(), &["man", "man1"]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let page = |name: &str| {
        let path = folder.path().join("man1").join(name);
        std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
    };
    for (name, words) in [
        ("sutura.1", "sutura\\-run(1)"),
        ("sutura-run.1", "\\-\\-host\\-hz"),
        ("sutura-device-selftest.1", "\\-\\-out"),
        ("sutura-mesh-info.1", "\\-\\-scale"),
    ] {
        let text = page(name);
        assert!(
            text.contains(".TH") && text.contains(words),
            "{name}: {text}"
        );
    }
}

/// Without cargo and without a checkout: a program that stands in for the emulator is started with the image beside the command.
#[cfg(target_os = "linux")]
#[test]
fn an_image_beside_the_program_is_the_emulators() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().expect("a folder");
    let bin = folder.path().join("bin");
    std::fs::create_dir(&bin).expect("made");
    let write = |name: &str, text: &str| -> PathBuf {
        let path = bin.join(name);
        std::fs::write(&path, text).expect("writable");
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755)).expect("ours");
        path
    };
    let log = folder.path().join("log");
    write(
        "qemu-system-arm",
        &format!("#!/bin/sh\necho \"$@\" >> {}\nexit 1\n", log.display()),
    );
    let image = write("sutura-virtual", "not an image");
    let program = bin.join("sutura");
    std::fs::copy(env!("CARGO_BIN_EXE_sutura"), &program).expect("copied");
    let mut command = Command::new(&program);
    command
        .args(["run", "--console", "qemu", "--seconds", "0.1"])
        .current_dir(folder.path())
        .env("PATH", format!("{}:/usr/bin:/bin", bin.display()));
    let ran = ran(&mut command);
    assert_ne!(ran.code, 0, "{}", ran.stdout);
    let asked = std::fs::read_to_string(&log).unwrap_or_default();
    assert!(
        asked.contains(&image.display().to_string()),
        "{asked}{}",
        ran.stderr
    );
}
