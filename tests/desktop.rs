//! README's first command at a desktop: the page's address before the session, and how it ends.
#![allow(clippy::unwrap_used, reason = "tests")]

use crate::support::terminal::Terminal;
use std::path::Path;
use tempfile::tempdir;

/// What a terminal shows is without colours here, and the bar's lines are none.
fn lines(said: &str) -> Vec<String> {
    let mut parts = said.split('\x1b');
    let mut plain = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        let end = part.find(|c: char| c.is_ascii_alphabetic());
        plain.push_str(end.map_or("", |end| &part[end + 1..]));
    }
    let lines = plain.lines().map(|line| line.trim().to_owned());
    lines.filter(|line| !line.is_empty()).collect()
}

const RUN: [&str; 5] = ["run", "--seconds", "0.5", "--view-port", "0"];

#[test]
fn at_a_desktop_the_address_comes_first() {
    for display in ["DISPLAY", "WAYLAND_DISPLAY"] {
        let folder = tempdir().unwrap();
        let place = folder.path().to_str().unwrap();
        let terminal = Terminal::start(&RUN, &[(display, ":0"), ("XDG_RUNTIME_DIR", place)]);
        let (code, said) = terminal.finish();
        let lines = lines(&said);
        let at = |words: &str| {
            let found = lines.iter().position(|line| line.contains(words));
            found.unwrap_or_else(|| panic!("no {words}: {lines:#?}"))
        };
        assert!(at("see it: http://127.0.0.1:") < at("by the console's clock"));
        // A machine that stands still may end the session, and says so last.
        if code == 0 {
            assert_eq!(lines.last().unwrap(), "see it: sutura view");
        } else {
            at("see it: sutura view");
        }
    }
}

#[test]
fn without_a_desktop_no_port_is_opened() {
    let folder = tempdir().unwrap();
    let place = folder.path().to_str().unwrap();
    for variables in [&[][..], &[("DISPLAY", "")]] {
        let all = [variables, &[("XDG_RUNTIME_DIR", place)]].concat();
        let (_, said) = Terminal::start(&RUN, &all).finish();
        assert!(said.contains("by the console's clock"), "{said}");
        assert!(!said.contains("see it"), "{said}");
        // A server writes down where it is.
        assert!(!Path::new(place).join("sutura").exists());
    }
}
