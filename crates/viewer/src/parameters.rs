//! The parameters of a request, as in `?robot=r7&limit=10`.

use std::num::ParseIntError;

/// The value of a parameter, with what `%` stands for; `None` where it is not given.
pub(crate) fn parameter(query: &str, name: &str) -> Option<String> {
    let value = query.split('&').find_map(|pair| pair.strip_prefix(name)?.strip_prefix('='))?;
    Some(decoded(value))
}

/// A parameter that is a number.
///
/// # Errors
/// Where it is given and no number.
pub(crate) fn number(query: &str, name: &str) -> Result<Option<u64>, ParseIntError> {
    parameter(query, name).map(|text| text.parse()).transpose()
}

fn decoded(value: &str) -> String {
    let mut bytes = Vec::with_capacity(value.len());
    let mut rest = value.as_bytes();
    while let Some((&first, after)) = rest.split_first() {
        let code = after.get(..2).and_then(|code| std::str::from_utf8(code).ok());
        let byte = code.filter(|_| first == b'%').and_then(|code| u8::from_str_radix(code, 16).ok());
        bytes.push(byte.unwrap_or(first));
        rest = if byte.is_some() { &after[2..] } else { after };
    }
    String::from_utf8_lossy(&bytes).into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_decoded_and_garbage_is_harmless() {
        assert_eq!(parameter("a=1&robot=r%C3%BC%267&b", "robot").as_deref(), Some("rü&7"));
        assert_eq!(parameter("robots=1", "robot"), None);
        for garbage in ["robot=%", "robot=%f", "robot=%zz", "robot=%+1", "robot=%ff", "&&=&robot="] {
            assert!(parameter(garbage, "robot").is_some(), "{garbage}");
        }
        assert_eq!(number("limit=7", "limit"), Ok(Some(7)));
        assert!(number("limit=-7", "limit").is_err());
    }
}
