//! What a command printed against what `sutura schema` says of it.

use super::sutura;
use serde_json::{Value, json};

/// The schema of that name, closed: a key that it does not have is refused.
fn schema(name: &str) -> Value {
    let ran = sutura(&["schema", name, "--format", "json"]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let mut schema = ran.json();
    close(&mut schema);
    schema
}

fn close(schema: &mut Value) {
    match schema {
        Value::Object(map) => {
            let has_keys = map.get("properties").is_some_and(Value::is_object);
            map.values_mut().for_each(close);
            if has_keys {
                map.insert("unevaluatedProperties".to_owned(), json!(false));
            }
        }
        Value::Array(list) => list.iter_mut().for_each(close),
        _ => {}
    }
}

/// Every key of `printed` is described, every one that always comes is there, and each is what it is said to be.
pub fn assert_described(name: &str, printed: &Value) {
    let schema = schema(name);
    let validator = jsonschema::validator_for(&schema).expect("a schema");
    let wrong: Vec<_> = validator
        .iter_errors(printed)
        .map(|error| {
            format!(
                "{} at {}",
                error.to_string().chars().take(300).collect::<String>(),
                error.instance_path()
            )
        })
        .take(5)
        .collect();
    assert!(
        wrong.is_empty(),
        "`sutura schema {name}` says otherwise: {wrong:#?}"
    );
}
