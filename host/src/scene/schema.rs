//! JSON Schema (2020-12) of a scene file, for editors and other programs that write scenes.
//!
//! Entry point: [`schema`]. Derived from the structs that read the file, so it knows the same keys; what
//! depends on several values, or on the mesh, only [`load`](super::load) can check.

use super::added::Whole;
use schemars::generate::SchemaSettings;
use schemars::transform::{Transform, transform_subschemas};
use schemars::{Schema, SchemaGenerator};
use serde_json::Value;

/// The schema of a scene file read as JSON.
pub fn schema() -> Value {
    let settings = SchemaSettings::draft2020_12().with_transform(AsToml);
    let mut schema = SchemaGenerator::new(settings).into_root_schema_for::<Whole>();
    schema.insert("title".to_owned(), "Sutura scene".into());
    schema.to_value()
}

/// TOML has no null: a key without a value is left out. And descriptions lose the marks of Rust's documents.
#[derive(Clone)]
struct AsToml;

impl Transform for AsToml {
    fn transform(&mut self, schema: &mut Schema) {
        if let Some(Value::Array(types)) = schema.get_mut("type") {
            types.retain(|name| name != "null");
            if let [only] = types.as_slice() {
                let only = only.clone();
                schema.insert("type".to_owned(), only);
            }
        }
        if let Some(Value::Array(choices)) = schema.get_mut("anyOf") {
            choices.retain(|choice| choice.get("type").is_none_or(|name| name != "null"));
            if let [Value::Object(only)] = choices.as_mut_slice() {
                let only = std::mem::take(only);
                schema.remove("anyOf");
                for (key, value) in only {
                    schema.insert(key, value);
                }
            }
        }
        if schema.get("default").is_some_and(Value::is_null) {
            schema.remove("default");
        }
        if let Some(Value::String(text)) = schema.get_mut("description") {
            *text = text.replace("\\[", "[").replace("\\]", "]");
        }
        transform_subschemas(self, schema);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every key is described, none takes null, and no mark of a Rust document is left.
    #[test]
    fn every_key_has_a_description_that_people_can_read() {
        let schema = schema();
        let sections = schema["$defs"].as_object().expect("sections").values();
        let mut keys = 0;
        for section in sections.chain([&schema]) {
            let properties = section.get("properties").and_then(Value::as_object);
            for (key, property) in properties.into_iter().flatten() {
                let text = property["description"].as_str().unwrap_or_default();
                assert!(text.len() > 5, "{key}: {property}");
                keys += 1;
            }
        }
        assert!(keys > 40, "{keys}");
        let text = schema.to_string();
        assert!(
            !text.contains("\"null\"") && !text.contains("\\\\["),
            "{text}"
        );
    }
}
