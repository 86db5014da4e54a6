//! Standard output that is closed by its reader.

/// Exit status of a program that wrote to a closed pipe, as shells report it.
const CLOSED_PIPE: i32 = 141;

/// Ends the program without a message when its standard output is closed, as in `driftless map-info --map hall.db | head`.
///
/// `println!` panics in that case. All files are written by then: programs print when they are done. Other panics are
/// reported as usual.
pub fn end_quietly_when_closed() {
    let report = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        let message = panic.payload_as_str().unwrap_or_default();
        if message.starts_with("failed printing to stdout") && message.contains("Broken pipe") {
            std::process::exit(CLOSED_PIPE);
        }
        report(panic);
    }));
}
