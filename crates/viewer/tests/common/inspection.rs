//! What Chromium knows of a page beside what it draws.

use crate::browser::Browser;
use serde_json::{Value, json};

impl Browser {
    /// What assistive technology is told: roles and names.
    pub async fn accessible(&mut self) -> Vec<(String, String)> {
        let tree = self.command("Accessibility.getFullAXTree", json!({})).await;
        let text = |value: &Value| value["value"].as_str().unwrap_or_default().to_owned();
        let nodes = tree["nodes"].as_array().unwrap().iter().filter(|node| node["ignored"] == false);
        nodes.map(|node| (text(&node["role"]), text(&node["name"]))).collect()
    }

    /// Bytes that the page's scripts hold: in objects, and in arrays beside them.
    pub async fn heap(&mut self) -> (f64, f64) {
        self.command("HeapProfiler.collectGarbage", json!({})).await;
        let usage = self.command("Runtime.getHeapUsage", json!({})).await;
        (usage["usedSize"].as_f64().unwrap(), usage["backingStorageSize"].as_f64().unwrap_or(0.0))
    }
}
