//! Keys by which scenes add sources: taken out of the file before the rest of it is read.
//!
//! Entry point: [`read`]. What there is says [`scene_keys`].

use super::document::{Document, SceneError};
use crate::source::{Section, scene_keys};
use schemars::{JsonSchema, Schema, SchemaGenerator};
use serde::Deserialize;
use std::borrow::Cow;
use std::ops::Range;
use sutura_scene_file::scene::{KEYS, SceneFile};
use toml::Spanned;
use toml::de::{DeTable, DeValue, ValueDeserializer};

/// A section by which a scene adds a source: where it is, and what it says.
pub(super) type AddedSection = (Range<usize>, Box<dyn Section>);

macro_rules! added {
    ($($(#[doc = $about:literal])* $key:ident: $section:ty;)*) => {
        /// Keys by which scenes add sources.
        pub const ADDED_KEYS: &[&str] = &[$(stringify!($key)),*];

        /// Sections of one of these keys.
        fn sections(key: &str, value: Spanned<DeValue<'_>>) -> Result<Vec<AddedSection>, toml::de::Error> {
            $(if key == stringify!($key) {
                return read_sections::<$section>(value);
            })*
            Ok(Vec::new())
        }

        /// Adds these keys to a schema's properties.
        fn describe(properties: &mut serde_json::Map<String, serde_json::Value>, generator: &mut SchemaGenerator) {
            $({
                let mut schema = generator.subschema_for::<Vec<$section>>();
                schema.insert("description".to_owned(), concat!($($about),*).trim().into());
                properties.insert(stringify!($key).to_owned(), schema.to_value());
            })*
        }
    };
}
scene_keys!(added);

fn read_sections<T>(value: Spanned<DeValue<'_>>) -> Result<Vec<AddedSection>, toml::de::Error>
where
    T: for<'de> Deserialize<'de> + Section + 'static,
{
    let sections = Vec::<Spanned<T>>::deserialize(ValueDeserializer::from(value))?;
    let sections = sections.into_iter();
    let placed = sections.map(|section| {
        let span = section.span();
        (span, Box::new(section.into_inner()) as Box<dyn Section>)
    });
    Ok(placed.collect())
}

/// Reads a scene's file, and the sections by which it adds sources, in the order of [`ADDED_KEYS`].
///
/// # Errors
/// What is wrong with the text, at its place.
pub(super) fn read(document: &Document) -> Result<(SceneFile, Vec<AddedSection>), SceneError> {
    let unread = |error: toml::de::Error| document.unread(&error);
    let mut table = DeTable::parse(document.text()).map_err(unread)?;
    let known = || KEYS.iter().chain(ADDED_KEYS);
    if let Some(key) = table
        .get_ref()
        .keys()
        .find(|key| !known().any(|known| known == key.get_ref()))
    {
        let known: Vec<String> = known().map(|key| format!("`{key}`")).collect();
        let message = format!(
            "unknown field `{}`, expected one of {}",
            key.get_ref(),
            known.join(", ")
        );
        return Err(document.said(key.span(), &message));
    }
    let mut added = Vec::new();
    for key in ADDED_KEYS {
        if let Some(value) = table.get_mut().remove(*key) {
            added.extend(sections(key, value).map_err(unread)?);
        }
    }
    Ok((SceneFile::read(table).map_err(unread)?, added))
}

/// A scene's file with the keys of added sources, for its schema.
pub(super) struct Whole;

impl JsonSchema for Whole {
    fn schema_name() -> Cow<'static, str> {
        SceneFile::schema_name()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let mut schema = SceneFile::json_schema(generator);
        if let Some(serde_json::Value::Object(properties)) = schema.get_mut("properties") {
            describe(properties, generator);
        }
        schema
    }
}
