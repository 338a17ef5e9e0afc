//! client/c/sutura.h is what cbindgen makes of the library. Write it anew with
//! `SUTURA_BLESS=1 cargo test -p sutura-capi --test header`.

use cbindgen::{Builder, Config, DocumentationStyle, Language, RenameRule, Style};
use std::path::Path;

const HEADER: &str = "\
/* Sutura's client: a haptic console for your own simulator. Written by cbindgen from client/capi; an example is sphere.c.
 *
 * Every function returns SUTURA_OK, SUTURA_NO_POSE, or a negative code, which sutura_last_error() puts into words. Any
 * thread may call any function with any handle, except that nobody uses a handle while or after it is closed. */";

#[test]
fn the_header_is_what_the_library_has() -> Result<(), Box<dyn std::error::Error>> {
    let mut config = Config {
        language: Language::C,
        header: Some(HEADER.to_owned()),
        include_guard: Some("SUTURA_H".to_owned()),
        no_includes: true,
        sys_includes: vec!["stdint.h".to_owned()],
        cpp_compat: true,
        style: Style::Type,
        documentation_style: DocumentationStyle::C99,
        line_length: 110,
        ..Config::default()
    };
    config.export.rename.extend(
        [
            ("SuturaConsole", "sutura_console"),
            ("SuturaOptions", "sutura_options"),
            ("SuturaInfo", "sutura_info"),
            ("SuturaPose", "sutura_pose"),
            ("SuturaContact", "sutura_contact"),
            ("SuturaFixture", "sutura_fixture"),
            ("SuturaWayPoint", "sutura_way_point"),
        ]
        .map(|(rust, c)| (rust.to_owned(), c.to_owned())),
    );
    config.structure.rename_fields = RenameRule::None;
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut made = Vec::new();
    Builder::new()
        .with_config(config)
        .with_src(here.join("src/error.rs"))
        .with_src(here.join("src/types.rs"))
        .with_src(here.join("src/lib.rs"))
        .generate()?
        .write(&mut made);
    let made = String::from_utf8(made)?;
    let path = here.join("../c/sutura.h");
    if std::env::var_os("SUTURA_BLESS").is_some() {
        std::fs::write(&path, &made)?;
    }
    let committed = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(
        made == committed,
        "client/c/sutura.h is not what the library has; `SUTURA_BLESS=1 cargo test -p sutura-capi --test header`"
    );
    Ok(())
}
