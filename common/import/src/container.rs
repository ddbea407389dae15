//! The two containers of a scene: JSON by itself, or JSON and one buffer in a `.glb`.

use crate::error::Fault;

const HEADER_BYTES: usize = 12;
const CHUNK_HEADER_BYTES: usize = 8;

/// The parts of a container.
#[derive(Debug)]
pub(crate) struct Container<'a> {
    /// The document.
    pub json: &'a [u8],
    /// Buffer 0, unless that has a URI.
    pub bin: Option<&'a [u8]>,
}

/// Takes `file` apart (glTF 2.0, section 4.4); its first bytes, not its name, tell what it is.
pub(crate) fn split(file: &[u8]) -> Result<Container<'_>, Fault> {
    if !file.starts_with(b"glTF") {
        return Ok(Container { json: file.strip_prefix(b"\xef\xbb\xbf").unwrap_or(file), bin: None });
    }
    let header = |offset: usize| read_u32(file, offset).ok_or_else(|| glb_fault("ends within its header"));
    let version = header(4)?;
    if version != 2 {
        return Err(glb_fault(format!(
            "has version {version}; only version 2 is read, so export it as glTF 2.0"
        )));
    }
    let length = header(8)? as usize;
    if length < HEADER_BYTES || length > file.len() {
        let held = file.len();
        return Err(glb_fault(format!(
            "claims {length} bytes, but the file has {held}; it may be cut short"
        )));
    }
    let mut rest = &file[HEADER_BYTES..length];
    let (kind, json) = next_chunk(&mut rest)?;
    if &kind != b"JSON" {
        return Err(glb_fault("does not begin with a JSON chunk"));
    }
    // Later chunks of other kinds are to be ignored.
    let mut bin = None;
    while bin.is_none() && !rest.is_empty() {
        let (kind, body) = next_chunk(&mut rest)?;
        bin = (&kind == b"BIN\0").then_some(body);
    }
    Ok(Container { json, bin })
}

fn next_chunk<'a>(rest: &mut &'a [u8]) -> Result<([u8; 4], &'a [u8]), Fault> {
    let bytes: &'a [u8] = rest;
    let cut = || glb_fault("ends within a chunk's header");
    let length = read_u32(bytes, 0).ok_or_else(cut)? as usize;
    let kind = *bytes.get(4..).and_then(|bytes| bytes.first_chunk()).ok_or_else(cut)?;
    let body = &bytes[CHUNK_HEADER_BYTES..];
    let Some((chunk, after)) = body.split_at_checked(length) else {
        let name = String::from_utf8_lossy(&kind).trim_end_matches('\0').to_owned();
        let held = body.len();
        return Err(glb_fault(format!("has a {name} chunk of {length} bytes where only {held} are left")));
    };
    *rest = after;
    Ok((kind, chunk))
}

fn read_u32(bytes: &[u8], offset: usize) -> Option<u32> {
    bytes.get(offset..)?.first_chunk().map(|bytes| u32::from_le_bytes(*bytes))
}

fn glb_fault(what: impl Into<String>) -> Fault {
    Fault::at("glb container", what)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn glb(chunks: &[(&[u8; 4], &[u8])]) -> Vec<u8> {
        let mut file = b"glTF\x02\0\0\0\0\0\0\0".to_vec();
        for (kind, body) in chunks {
            file.extend((body.len() as u32).to_le_bytes());
            file.extend_from_slice(*kind);
            file.extend_from_slice(body);
        }
        let length = file.len() as u32;
        file[8..12].copy_from_slice(&length.to_le_bytes());
        file
    }

    #[test]
    fn a_glb_gives_its_json_and_its_buffer_past_chunks_of_other_kinds() {
        let file = glb(&[(b"JSON", b"{}"), (b"XTRA", b"..."), (b"BIN\0", b"bytes")]);
        let container = split(&file).expect("well formed");
        assert_eq!((container.json, container.bin), (&b"{}"[..], Some(&b"bytes"[..])));
        let empty = glb(&[(b"JSON", b"{}"), (b"BIN\0", b"")]);
        assert_eq!(split(&empty).expect("an empty buffer is one").bin, Some(&b""[..]));
        assert_eq!(split(b"\xef\xbb\xbf{}").expect("a byte order mark").json, b"{}");
    }

    #[test]
    fn lengths_that_lie_are_refused() {
        let whole = glb(&[(b"JSON", b"{}"), (b"BIN\0", b"bytes")]);
        for len in 4..whole.len() {
            let what = split(&whole[..len]).expect_err("cut short").what;
            assert!(what.contains("ends within") || what.contains("cut short"), "{len}: {what}");
        }
        let mut greedy = whole.clone();
        greedy[12..16].copy_from_slice(&u32::MAX.to_le_bytes());
        assert!(split(&greedy).expect_err("too long").what.contains("JSON chunk of 4294967295 bytes"));
        for length in [0_u32, 11, u32::MAX] {
            let mut liar = whole.clone();
            liar[8..12].copy_from_slice(&length.to_le_bytes());
            assert!(split(&liar).is_err(), "{length}");
        }
        assert!(split(&glb(&[(b"BIN\0", b"")])).is_err());
        let mut old = whole;
        old[4] = 1;
        assert!(split(&old).expect_err("version 1").what.contains("version 1"));
    }
}
