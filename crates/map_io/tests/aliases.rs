//! Maps that state which places look alike, as text.

use map_io::text;
use testing::{Place, PlaceOptions, add_aliases};

#[test]
fn the_aliases_of_a_map_are_read_back() {
    for is_searched in [false, true] {
        let folder = tempfile::tempdir().unwrap();
        let mut contents =
            Place::new(&PlaceOptions { keyframes: 8, landmarks: 80, ..PlaceOptions::default() }).map;
        contents.sort();
        if is_searched {
            add_aliases(&mut contents);
        }
        text::write_map(folder.path(), &contents).unwrap();
        assert_eq!(folder.path().join("aliases.csv").exists(), is_searched);
        assert_eq!(text::read_map(folder.path()).unwrap().aliases, contents.aliases);
    }
}
