//! The picture of the crates is that of their manifests.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;

use serde_json::Value;
use tests::crates_picture::{Crate, draw};

/// Crates that are not part of the product.
const LEFT_OUT: [&str; 4] = ["benches", "fuzz", "testing", "tests"];

/// The name of a crate without the prefix of its package.
fn short(package: &str) -> String {
    package.trim_start_matches("driftless-").replace('-', "_")
}

/// What cargo prints.
fn cargo(root: &Path, arguments: &[&str]) -> Vec<u8> {
    let cargo = std::env::var("CARGO").unwrap_or_else(|_| "cargo".to_owned());
    let always = ["--offline", "--locked"];
    let output = Command::new(cargo).args(arguments).args(always).current_dir(root).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    output.stdout
}

/// The folder of the workspace.
fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap()
}

/// The crates of this workspace, by cargo.
fn crates(root: &Path) -> BTreeMap<String, Crate> {
    let metadata = cargo(root, &["metadata", "--no-deps", "--format-version", "1"]);
    let metadata: Value = serde_json::from_slice(&metadata).unwrap();
    let packages = metadata["packages"].as_array().unwrap();
    let text = |value: &Value| value.as_str().unwrap().to_owned();
    let is_drawn = |package: &&Value| !LEFT_OUT.contains(&short(&text(&package["name"])).as_str());
    let names: Vec<String> = packages.iter().filter(is_drawn).map(|package| text(&package["name"])).collect();
    let read = |package: &Value| {
        let has_program = |target: &Value| target["kind"].as_array().unwrap().contains(&"bin".into());
        let of_users = package["dependencies"].as_array().unwrap().iter().filter(|on| on["kind"].is_null());
        let on = of_users.map(|on| text(&on["name"])).filter(|name| names.contains(name));
        Crate {
            description: text(&package["description"]),
            is_program: package["targets"].as_array().unwrap().iter().any(has_program),
            dependencies: on.map(|name| short(&name)).collect(),
        }
    };
    packages.iter().filter(is_drawn).map(|package| (short(&text(&package["name"])), read(package))).collect()
}

/// `UPDATE=1` writes the picture.
#[test]
fn dependencies_run_downward_and_the_picture_shows_them() {
    let root = root();
    let crates = crates(root);
    let picture = draw(&crates).unwrap_or_else(|circle| panic!("these depend on each other: {circle:?}"));
    let path = root.join("docs/src/images/crates.svg");
    if std::env::var_os("UPDATE").is_some() {
        std::fs::write(&path, &picture).unwrap();
    }
    let drawn = std::fs::read_to_string(&path).unwrap();
    assert!(
        drawn == picture,
        "the manifests have changed: UPDATE=1 cargo test -p driftless-tests crates_picture"
    );
    let table = std::fs::read_to_string(root.join("ARCHITECTURE.md")).unwrap();
    for name in crates.keys() {
        let is_listed =
            [format!("| `{name}` |"), format!("| `crates/{name}` |")].iter().any(|row| table.contains(row));
        assert!(is_listed, "ARCHITECTURE.md does not list {name}");
    }
}

#[test]
fn an_embedded_robot_links_no_command_line_no_ros_no_metrics_and_no_files_of_runs() {
    let tree = cargo(root(), &["tree", "-p", "driftless-robot", "-e", "normal", "--prefix", "none"]);
    let tree = String::from_utf8(tree).unwrap();
    let linked = |name: &str| tree.lines().any(|line| line.split(' ').next() == Some(name));
    assert!(linked("driftless-estimator") && linked("zenoh"), "{tree}");
    for name in
        ["clap", "driftless-ros2", "prometheus-client", "driftless-monitoring", "driftless-evaluation"]
    {
        assert!(!linked(name), "{name} is linked:\n{tree}");
    }
}

#[test]
fn a_circle_is_named() {
    let of = |on: &str| Crate { dependencies: [on.to_owned()].into(), ..Crate::default() };
    let crates = [("a", of("b")), ("b", of("a")), ("c", of("a"))];
    let crates: BTreeMap<String, Crate> = crates.map(|(name, what)| (name.to_owned(), what)).into();
    assert_eq!(draw(&crates).unwrap_err(), ["a", "b", "c"]);
}
