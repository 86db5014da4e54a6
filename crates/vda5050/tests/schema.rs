//! The JSON schemas of VDA 5050 2.1.0, and whether a message satisfies them.
//!
//! Only the keywords that these schemas use are known; any other is refused, so that nothing is left unchecked. The Python tests of the
//! repository judge the same messages by the package `jsonschema`.

use serde_json::Value;

const VISUALIZATION: &str = include_str!("schemas/visualization.schema");
const CONNECTION: &str = include_str!("schemas/connection.schema");

/// Keywords without a meaning for validity.
const NOTES: [&str; 6] = ["$schema", "title", "description", "examples", "subtopic", "format"];

/// What is wrong with a message, by the schema of its topic.
pub fn faults(topic: &str, message: &Value) -> Vec<String> {
    let schema = if topic.ends_with("connection") { CONNECTION } else { VISUALIZATION };
    let mut faults = Vec::new();
    check(&serde_json::from_str(schema).unwrap(), message, topic, &mut faults);
    faults
}

fn check(schema: &Value, value: &Value, at: &str, faults: &mut Vec<String>) {
    for (keyword, rule) in schema.as_object().unwrap() {
        let is_fulfilled = match keyword.as_str() {
            "type" => match rule.as_str().unwrap() {
                "object" => value.is_object(),
                "string" => value.is_string(),
                "integer" => value.is_u64() || value.is_i64(),
                "number" => value.is_number(),
                "boolean" => value.is_boolean(),
                other => panic!("unknown type {other}"),
            },
            "required" => {
                rule.as_array().unwrap().iter().all(|name| value.get(name.as_str().unwrap()).is_some())
            }
            "enum" => rule.as_array().unwrap().contains(value),
            "minimum" => value.as_f64().is_some_and(|number| number >= rule.as_f64().unwrap()),
            "maximum" => value.as_f64().is_some_and(|number| number <= rule.as_f64().unwrap()),
            "properties" => {
                let known = rule.as_object().unwrap();
                for (name, of) in known {
                    if let Some(value) = value.get(name) {
                        check(of, value, &format!("{at}/{name}"), faults);
                    }
                }
                // Schemas allow more; these messages have nothing else.
                value.as_object().is_some_and(|object| object.keys().all(|name| known.contains_key(name)))
            }
            note if NOTES.contains(&note) => true,
            other => panic!("unknown keyword {other}"),
        };
        if !is_fulfilled {
            faults.push(format!("{at}: {keyword} {rule} by {value}"));
        }
    }
}
