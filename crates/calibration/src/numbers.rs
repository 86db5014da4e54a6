//! Numbers as text that reads back as exactly these numbers.

/// The shortest decimal text of a number.
pub fn shortest(value: f64) -> String {
    let magnitude = value.abs();
    if magnitude == 0.0 || (1e-5..1e15).contains(&magnitude) {
        format!("{value}")
    } else {
        format!("{value:e}")
    }
}

/// Numbers separated by commas, each as [`shortest`].
pub fn list(values: &[f64]) -> String {
    values.iter().map(|&value| shortest(value)).collect::<Vec<_>>().join(", ")
}
