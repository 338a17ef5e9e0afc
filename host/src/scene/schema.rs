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
    use crate::scene::{Document, Scene};
    use std::path::Path;

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

    /// A scene with every key of which the schema says a bound.
    const BOUNDED: &str = r#"
seconds = 2.0
[mesh.slab]
size_m = [0.04, 0.04, 0.02]
divisions = [4, 4, 2]
[tissue]
youngs_modulus_pa = 1e4
poisson_ratio = 0.4
density_kg_per_m3 = 1000.0
[[region]]
box = { min_m = [-1.0, -1.0, -0.01], max_m = [1.0, 1.0, 1.0] }
youngs_modulus_pa = 1e4
poisson_ratio = 0.4
density_kg_per_m3 = 1000.0
[[fixed]]
plane = { axis = "z", at_m = -0.02 }
[[tool]]
id = 0
radius_m = 0.012
[[tool]]
id = 1
shape = "rounded-box"
driven = false
size_m = [0.02, 0.02, 0.02]
side = [0.0, 1.0, 0.0]
position_m = [0.0, 0.0, 0.1]
[[tool]]
id = 2
shape = "mesh"
driven = false
mesh = "tests/data/ring.stl"
scale_to_m = 0.001
position_m = [0.1, 0.0, 0.1]
[host]
host_hz = 100.0
horizon_ms = 50.0
"#;

    /// What is outside of a bound is refused by the reader, at that key; what is at a bound or inside, by nothing.
    #[test]
    fn bounds_are_those_of_the_reader() {
        let schema = schema();
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
        let refused = |places: &[&str], value: f64| {
            let mut file: toml::Value = toml::from_str(BOUNDED).expect("TOML");
            let mut at = &mut file;
            for place in places {
                at = match place.parse::<usize>() {
                    Ok(index) => &mut at[index],
                    Err(_) => &mut at[*place],
                };
            }
            *at = value.into();
            let text = toml::to_string(&file).expect("TOML");
            let read = Scene::read(&Document::embedded("test.toml", &root, &text), "test");
            read.err().map(|error| error.to_string())
        };
        let mut bounds = 0;
        for (section, key, places) in [
            ("", "seconds", &["seconds"][..]),
            ("SlabSection", "size_m", &["mesh", "slab", "size_m", "1"]),
            (
                "TissueSection",
                "youngs_modulus_pa",
                &["tissue", "youngs_modulus_pa"],
            ),
            (
                "TissueSection",
                "poisson_ratio",
                &["tissue", "poisson_ratio"],
            ),
            (
                "TissueSection",
                "density_kg_per_m3",
                &["tissue", "density_kg_per_m3"],
            ),
            (
                "RegionSection",
                "youngs_modulus_pa",
                &["region", "0", "youngs_modulus_pa"],
            ),
            (
                "RegionSection",
                "poisson_ratio",
                &["region", "0", "poisson_ratio"],
            ),
            (
                "RegionSection",
                "density_kg_per_m3",
                &["region", "0", "density_kg_per_m3"],
            ),
            ("ToolSection", "radius_m", &["tool", "0", "radius_m"]),
            ("ToolSection", "size_m", &["tool", "1", "size_m", "2"]),
            ("ToolSection", "scale_to_m", &["tool", "2", "scale_to_m"]),
            ("HostSection", "host_hz", &["host", "host_hz"]),
            ("HostSection", "horizon_ms", &["host", "horizon_ms"]),
        ] {
            let own = if section.is_empty() {
                &schema
            } else {
                &schema["$defs"][section]
            };
            let mut property = &own["properties"][key];
            property = property.get("items").unwrap_or(property);
            let of = |bound: &str| property.get(bound).and_then(Value::as_f64);
            for (bound, outwards, is_in) in [
                ("minimum", -1.0, true),
                ("maximum", 1.0, true),
                ("exclusiveMinimum", -1.0, false),
                ("exclusiveMaximum", 1.0, false),
            ] {
                let Some(limit) = of(bound) else {
                    continue;
                };
                bounds += 1;
                let off = 1e-3 * limit.abs().max(1e-3);
                let said = refused(places, limit + outwards * off).expect(key);
                assert!(said.contains(key), "{key}: {said}");
                assert_eq!(refused(places, limit).is_none(), is_in, "{key} {bound}");
            }
        }
        assert_eq!(bounds, 20);
    }
}
