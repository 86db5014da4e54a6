//! The files of the page, which are part of the program.

/// A file of the page.
#[derive(Clone, Copy, Debug)]
pub struct Asset {
    /// Its path below `/`.
    pub path: &'static str,
    /// Its media type.
    pub media_type: &'static str,
    /// Its bytes.
    pub bytes: &'static [u8],
}

const HTML: &str = "text/html; charset=utf-8";
const CSS: &str = "text/css; charset=utf-8";
const SCRIPT: &str = "text/javascript; charset=utf-8";
const TEXT: &str = "text/plain; charset=utf-8";

macro_rules! page_file {
    ($path:literal, $media_type:expr) => {
        Asset { path: $path, media_type: $media_type, bytes: include_bytes!(concat!("../page/", $path)) }
    };
}

/// All files of the page. Whatever is not in this table is not served.
pub const ASSETS: &[Asset] = &[
    page_file!("index.html", HTML),
    page_file!("style.css", CSS),
    page_file!("main.js", SCRIPT),
    page_file!("scene.js", SCRIPT),
    page_file!("map_layer.js", SCRIPT),
    page_file!("robot_layer.js", SCRIPT),
    page_file!("panel.js", SCRIPT),
    page_file!("presence.js", SCRIPT),
    page_file!("names.js", SCRIPT),
    page_file!("load.js", SCRIPT),
    page_file!("live.js", SCRIPT),
    page_file!("replay.js", SCRIPT),
    page_file!("history.js", SCRIPT),
    page_file!("timeline.js", SCRIPT),
    page_file!("tabs.js", SCRIPT),
    page_file!("queries.js", SCRIPT),
    page_file!("query_layer.js", SCRIPT),
    page_file!("image_query.js", SCRIPT),
    page_file!("keyframe_dialog.js", SCRIPT),
    page_file!("server_chart.js", SCRIPT),
    page_file!("chart.js", SCRIPT),
    page_file!("changes_layer.js", SCRIPT),
    page_file!("colors.js", SCRIPT),
    page_file!("vendor/three.module.js", SCRIPT),
    page_file!("vendor/three.core.js", SCRIPT),
    page_file!("vendor/OrbitControls.js", SCRIPT),
    page_file!("vendor/LICENSE", TEXT),
];

/// The file of a path below `/`; the empty path is the page itself.
pub fn asset(path: &str) -> Option<&'static Asset> {
    let path = if path.is_empty() { "index.html" } else { path };
    ASSETS.iter().find(|asset| asset.path == path)
}
