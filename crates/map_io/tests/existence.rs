//! Maps that state whether their landmarks are still there, as text.

use map_io::text;
use testing::{Place, PlaceOptions, add_existence};

#[test]
fn the_existence_of_landmarks_is_read_back() {
    let folder = tempfile::tempdir().unwrap();
    let mut contents =
        Place::new(&PlaceOptions { keyframes: 8, landmarks: 80, ..PlaceOptions::default() }).map;
    add_existence(&mut contents);
    text::write_map(folder.path(), &contents).unwrap();
    let read = text::read_map(folder.path()).unwrap();
    assert_eq!(read.existence, contents.existence);
    let existence = folder.path().join("existence.csv");
    std::fs::write(&existence, "#landmark,log-odds,timestamp [ns],last seen [ns]\n999999,1,2,3\n").unwrap();
    let said = text::read_map(folder.path()).unwrap_err().to_string();
    assert!(said.contains("existence of landmark 999999"), "{said}");
}
