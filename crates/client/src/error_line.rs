//! Errors as programs print them.

use std::error::Error;

/// An error and its causes in one line. Many errors state their cause themselves: nothing is repeated.
///
/// ```
/// let cause = std::io::Error::other("the disk is full");
/// assert_eq!(client::error_line(&cause), "the disk is full");
/// ```
pub fn error_line(error: &(dyn Error + 'static)) -> String {
    let mut line = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        let text = error.to_string();
        if !line.contains(&text) {
            line = format!("{line}: {text}");
        }
        cause = error.source();
    }
    line
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fmt;

    #[derive(Debug)]
    struct Layer(&'static str, Option<Box<Layer>>);

    impl fmt::Display for Layer {
        fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
            formatter.write_str(self.0)
        }
    }

    impl Error for Layer {
        fn source(&self) -> Option<&(dyn Error + 'static)> {
            self.1.as_deref().map(|cause| cause as _)
        }
    }

    #[test]
    fn a_cause_that_was_stated_already_is_not_stated_again() {
        let deepest = Layer("it is in g", None);
        let stated = Layer("/imu: it is in g", Some(Box::new(deepest)));
        assert_eq!(error_line(&stated), "/imu: it is in g");
        let outer = Layer("the recording cannot be read", Some(Box::new(stated)));
        assert_eq!(error_line(&outer), "the recording cannot be read: /imu: it is in g");
    }
}
