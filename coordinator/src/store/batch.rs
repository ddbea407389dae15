//! Several partials in one object, so that one put makes them all durable: an ordinary tar of ordinary EXR files.

use farm_film::{Tile, WorkUnit};
use std::io::Read;

/// The file name of a partial: the same unit has the same name.
pub(super) fn partial_name(unit: &WorkUnit) -> String {
    let (tile, block) = (unit.tile, unit.block);
    format!("{}-{}-{}-{}.exr", tile.x0(), tile.y0(), block.start(), block.end())
}

/// Whether a partial's name says that it is of this tile.
pub(super) fn is_of_tile(name: &str, tile: Tile) -> bool {
    name.starts_with(&format!("{}-{}-", tile.x0(), tile.y0()))
}

/// A tar of partials, by name.
pub(super) fn pack(partials: impl Iterator<Item = (String, impl AsRef<[u8]>)>) -> Vec<u8> {
    let mut archive = tar::Builder::new(Vec::new());
    for (name, bytes) in partials {
        let (bytes, mut header) = (bytes.as_ref(), tar::Header::new_ustar());
        header.set_size(bytes.len() as u64);
        header.set_mode(0o644);
        archive.append_data(&mut header, name, bytes).expect("memory takes everything");
    }
    archive.into_inner().expect("memory takes everything")
}

/// The files of a tar: their names and contents. What is damaged ends the list with a reason.
pub(super) fn unpack(bytes: &[u8]) -> (Vec<(String, Vec<u8>)>, Option<String>) {
    let mut files = Vec::new();
    let mut read = || -> std::io::Result<()> {
        for entry in tar::Archive::new(bytes).entries()? {
            let mut entry = entry?;
            let name = entry.path()?.display().to_string();
            let mut file = Vec::new();
            entry.read_to_end(&mut file)?;
            files.push((name, file));
        }
        Ok(())
    };
    let fault = read().err().map(|err| err.to_string());
    (files, fault)
}

#[cfg(test)]
mod tests {
    use super::*;
    use farm_film::{FrameIndex, SampleBlock};

    #[test]
    fn files_come_out_as_they_went_in() {
        let unit = |start: u64| WorkUnit {
            frame: FrameIndex(3),
            tile: Tile::new(0, 8, 16, 24).unwrap(),
            block: SampleBlock::new(start..start + 16).unwrap(),
        };
        let files = [(unit(0), vec![1; 700]), (unit(16), vec![]), (unit(32), vec![7; 512])];
        let packed = pack(files.iter().map(|(unit, bytes)| (partial_name(unit), &bytes[..])));
        let expected = files.clone().map(|(unit, bytes)| (partial_name(&unit), bytes));
        assert_eq!(unpack(&packed), (expected.to_vec(), None));
        assert_eq!(expected[1].0, "0-8-16-32.exr");
        let (found, fault) = unpack(&packed[..packed.len() / 2 + 100]);
        assert_eq!(found, expected[..found.len()]);
        assert!(fault.is_some());
    }
}
