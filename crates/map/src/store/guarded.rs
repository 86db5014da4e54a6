//! Calls into a database that may panic on damaged files.

use std::any::Any;
use std::cell::Cell;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Once;

use super::error::DatabaseError;

/// What the names of sled's threads begin with.
const DATABASE_THREADS: &str = "sled-io-";

thread_local! {
    static SILENT: Cell<bool> = const { Cell::new(false) };
}

/// Calls `work`; a panic in it is an error, and prints nothing.
///
/// # Errors
/// [`DatabaseError::Panicked`].
pub(super) fn call<T>(work: impl FnOnce() -> T) -> Result<T, DatabaseError> {
    silence_database_panics();
    SILENT.set(true);
    let result = catch_unwind(AssertUnwindSafe(work));
    SILENT.set(false);
    result.map_err(|panic| DatabaseError::Panicked { message: text_of(panic.as_ref()) })
}

/// Puts a panic hook before the present one that drops the messages of calls by [`call`] and of the database's own
/// threads. Those of all other threads pass.
fn silence_database_panics() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        let previous = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |panic| {
            let of_database =
                || std::thread::current().name().is_some_and(|name| name.starts_with(DATABASE_THREADS));
            if !SILENT.get() && !of_database() {
                previous(panic);
            }
        }));
    });
}

fn text_of(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().map(|text| (*text).to_owned());
    text.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_else(|| "no message".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_is_an_error_with_its_text() {
        let error = call(|| panic!("page {} is gone", 7)).unwrap_err();
        assert!(error.to_string().contains("page 7 is gone"), "{error}");
    }
}
