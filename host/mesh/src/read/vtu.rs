//! Reads VTK's XML, `.vtu`: arrays as text, base64 or raw bytes, inline or appended, plain or compressed by zlib.
//!
//! Entry point: [`read_vtu`]. Format: VTK File Formats, "XML File Formats". Nothing is set aside for a count that the
//! file announces. Cells come first, and arrays are unpacked no further than the cells need.

use super::super::{MeshError, Place, RawMesh};
use super::regions::Head;
use super::scan::{Endian, Kind, Number, no_text};
use super::vtk::Grid;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use flate2::read::ZlibDecoder;
use roxmltree::{Document, Node, ParsingOptions};
use std::cell::Cell;
use std::io::Read;

/// Bytes of memory that a number takes here, whatever its type in the file.
const A_NUMBER: u64 = 8;
/// Memory that packed arrays may take at most \[bytes\], besides [`TIMES`] the file's size.
const ROOM: u64 = 64 << 20;
/// Packed meshes are a third to a fiftieth of what they take.
const TIMES: u64 = 100;
/// Elements of XML at most: a piece of a mesh has some twenty.
const MOST_ELEMENTS: u32 = 1_000_000;
/// Attributes of an element at most: the parser compares each with each.
const MOST_ATTRIBUTES: u32 = 1_000;

/// Reads a file, in its own unit of length. Regions are those of the cell array of the name `region_array`, or of a
/// name that is known.
///
/// # Errors
/// A [`MeshError`] with the line of the array; volume cells other than tetrahedra are refused.
pub(super) fn read_vtu(bytes: &[u8], region_array: Option<&str>) -> Result<RawMesh, MeshError> {
    let (text, appended) = split(bytes)?;
    check_attributes(&text)?;
    let options = ParsingOptions {
        nodes_limit: MOST_ELEMENTS,
        ..ParsingOptions::default()
    };
    let document =
        Document::parse_with_options(&text, options).map_err(|error| MeshError::Syntax {
            at: Place::Line(error.pos().row as usize),
            expected: "XML that is whole; is the file cut off?".into(),
            found: error.to_string(),
        })?;
    let most = ROOM + TIMES * bytes.len() as u64;
    let file = File {
        document: &document,
        appended,
        layout: Layout::of(&document)?,
        most,
        room: Cell::new(most),
    };
    let root = document.root_element();
    let mut grid = Grid::new(region_array);
    let pieces: Vec<_> = root
        .descendants()
        .filter(|n| n.has_tag_name("Piece"))
        .collect();
    if pieces.is_empty() {
        return Err(MeshError::NoSection("Piece"));
    }
    // One array has the regions in all pieces.
    for array in pieces.iter().flat_map(|piece| arrays(*piece, "CellData")) {
        grid.arrays.takes(head(array));
    }
    for piece in &pieces {
        file.piece(*piece, &mut grid)?;
    }
    file.regions(&pieces, &mut grid)?;
    let end = file.place(root);
    grid.into_mesh(end)
}

/// Checks that no element has more attributes than [`MOST_ATTRIBUTES`].
fn check_attributes(text: &str) -> Result<(), MeshError> {
    // Attributes of the present tag so far, and the quote that is open in it.
    let mut tag = None;
    let mut quote = None;
    let mut line = 1;
    for byte in text.bytes() {
        line += usize::from(byte == b'\n');
        match (&mut tag, quote) {
            (None, _) if byte == b'<' => tag = Some(0),
            (Some(_), Some(end)) if byte == end => quote = None,
            (Some(_), None) if byte == b'>' => tag = None,
            (Some(_), None) if matches!(byte, b'"' | b'\'') => quote = Some(byte),
            (Some(count), None) if byte == b'=' => {
                *count += 1;
                if *count > MOST_ATTRIBUTES {
                    return Err(MeshError::Syntax {
                        at: Place::Line(line),
                        expected: format!("an element with at most {MOST_ATTRIBUTES} attributes"),
                        found: "one with more".into(),
                    });
                }
            }
            _ => {}
        }
    }
    Ok(())
}

/// The XML, and what is appended to it as bytes, which need not be text.
fn split(bytes: &[u8]) -> Result<(String, &[u8]), MeshError> {
    const TAG: &[u8] = b"<AppendedData";
    let start = bytes.windows(TAG.len()).position(|window| window == TAG);
    let (head, rest) = bytes.split_at(start.unwrap_or(bytes.len()));
    let line = |end: usize| {
        let lines = bytes.iter().take(end).filter(|b| **b == b'\n');
        Place::Line(1 + lines.count())
    };
    let text = |start: usize, bytes: &[u8]| {
        let text = std::str::from_utf8(bytes).map(str::to_owned);
        text.map_err(|error| no_text("text", bytes, start, error))
    };
    let mut xml = text(0, head)?;
    if start.is_none() {
        return Ok((xml, &[]));
    }
    let cut_off = |what: &str| MeshError::Truncated {
        at: line(bytes.len()),
        expected: what.into(),
    };
    let close = rest.iter().position(|b| *b == b'>');
    let close = close.ok_or_else(|| cut_off("the end of <AppendedData"))?;
    let (tag, data) = rest.split_at(close);
    xml.push_str(text(head.len(), tag)?.trim_end_matches('/'));
    xml.push_str("/></VTKFile>");
    let data = data[1..].trim_ascii_start();
    let data = data.strip_prefix(b"_");
    Ok((
        xml,
        data.ok_or_else(|| cut_off("_ before the appended data"))?,
    ))
}

/// What the head of a file says of all its arrays.
struct Layout {
    endian: Endian,
    /// Type of the numbers before an array's bytes.
    header: Kind,
    is_compressed: bool,
    /// Whether appended data are base64.
    is_base64: bool,
}

impl Layout {
    fn of(document: &Document<'_>) -> Result<Layout, MeshError> {
        let root = document.root_element();
        let row = document.text_pos_at(root.range().start).row;
        let refuse = |expected: &str, found: &str| MeshError::Syntax {
            at: Place::Line(row as usize),
            expected: expected.into(),
            found: format!("`{found}`"),
        };
        let is = |key: &str| root.attribute(key);
        if !root.has_tag_name("VTKFile") || is("type") != Some("UnstructuredGrid") {
            let found = is("type").unwrap_or(root.tag_name().name());
            return Err(refuse("<VTKFile type=\"UnstructuredGrid\">", found));
        }
        let endian = match is("byte_order") {
            None | Some("LittleEndian") => Endian::Little,
            Some("BigEndian") => Endian::Big,
            Some(other) => return Err(refuse("LittleEndian or BigEndian", other)),
        };
        let header = match is("header_type") {
            None | Some("UInt32") => Kind::U32,
            Some("UInt64") => Kind::U64,
            Some(other) => return Err(refuse("a header_type of UInt32 or UInt64", other)),
        };
        let is_compressed = match is("compressor") {
            None | Some("") => false,
            Some("vtkZLibDataCompressor") => true,
            Some(other) => {
                let what = "no compressor, or vtkZLibDataCompressor: save the file again so";
                return Err(refuse(what, other));
            }
        };
        let appended = root.children().find(|n| n.has_tag_name("AppendedData"));
        let is_base64 = match appended.map(|node| node.attribute("encoding").unwrap_or("base64")) {
            Some("raw") => false,
            None | Some("base64") => true,
            Some(other) => return Err(refuse("an encoding of raw or base64", other)),
        };
        Ok(Layout {
            endian,
            header,
            is_compressed,
            is_base64,
        })
    }
}

/// The arrays of a part of a piece.
fn arrays<'d>(piece: Node<'d, 'd>, of: &str) -> impl Iterator<Item = Node<'d, 'd>> {
    let part = piece.children().find(|n| n.has_tag_name(of));
    let children = part.into_iter().flat_map(|part| part.children());
    children.filter(|n| n.has_tag_name("DataArray"))
}

fn head<'d>(array: Node<'d, 'd>) -> Head<'d> {
    let width = array.attribute("NumberOfComponents").unwrap_or("1");
    Head {
        name: array.attribute("Name").unwrap_or(""),
        width: width.trim().parse().unwrap_or(0),
        is_whole: array.attribute("type").is_some_and(|of| of.contains("Int")),
    }
}

struct File<'d> {
    document: &'d Document<'d>,
    appended: &'d [u8],
    layout: Layout,
    /// Memory that binary arrays may take in all \[bytes\], and what is left of it.
    most: u64,
    room: Cell<u64>,
}

/// Count and type of an array's numbers that are needed.
#[derive(Clone, Copy)]
struct Wanted<'w> {
    count: u64,
    what: &'w str,
    /// Whether there may be no more.
    exact: bool,
}

impl<'w> Wanted<'w> {
    fn exactly(count: u64, what: &'w str) -> Self {
        Self {
            count,
            what,
            exact: true,
        }
    }
}

/// The numbers of an array.
enum Values<'d> {
    Words(&'d str),
    /// Bytes of those that are needed, their type, and how many there are in all.
    Bytes(Vec<u8>, Kind, u64),
}

impl<'d> File<'d> {
    fn place(&self, node: Node<'_, '_>) -> Place {
        let position = self.document.text_pos_at(node.range().start);
        Place::Line(position.row as usize)
    }

    fn expected(&self, node: Node<'_, '_>, expected: &str, found: &str) -> MeshError {
        MeshError::Syntax {
            at: self.place(node),
            expected: expected.into(),
            found: format!("`{}`", found.chars().take(60).collect::<String>()),
        }
    }

    fn cut_off(&self, node: Node<'_, '_>, expected: &str) -> MeshError {
        let name = node.attribute("Name").unwrap_or("Points");
        MeshError::Truncated {
            at: self.place(node),
            expected: format!("{expected} of the array {name}"),
        }
    }

    fn count(&self, piece: Node<'_, '_>, key: &str) -> Result<u64, MeshError> {
        let text = piece.attribute(key).unwrap_or("");
        let count = text.trim().parse();
        count.map_err(|_| self.expected(piece, &format!("{key}, a number from 0 up"), text))
    }

    /// Adds the cells and points of a piece.
    fn piece(&self, piece: Node<'d, 'd>, grid: &mut Grid) -> Result<(), MeshError> {
        let (points, cells) = (
            self.count(piece, "NumberOfPoints")?,
            self.count(piece, "NumberOfCells")?,
        );
        let cell_array = |name: &'static str| {
            let node = arrays(piece, "Cells").find(|n| n.attribute("Name") == Some(name));
            node.ok_or(MeshError::NoSection(name))
        };
        // Reports a missing array before anything is unpacked.
        let connectivity = cell_array("connectivity")?;
        let (offsets, types) = (cell_array("offsets")?, cell_array("types")?);
        let coordinates = arrays(piece, "Points").next();
        let coordinates = coordinates.ok_or(MeshError::NoSection("Points"))?;

        let at = self.place(types);
        self.each(types, Wanted::exactly(cells, "types"), |number| {
            let kind = number.index();
            kind.map(|kind| grid.kinds.push((kind, at))).is_some()
        })?;
        let start = grid.nodes.len();
        let mut last = start;
        let wanted = Wanted::exactly(cells, "offsets that ascend");
        self.each(offsets, wanted, |number| {
            let offset = number.index().and_then(|end| usize::try_from(end).ok());
            let end = offset.and_then(|end| end.checked_add(start));
            end.filter(|end| *end >= last)
                .map(|end| {
                    last = end;
                    grid.ends.push(end);
                })
                .is_some()
        })?;
        let first = grid.points.len();
        let wanted = Wanted {
            count: (last - start) as u64,
            what: "nodes of cells",
            exact: false,
        };
        self.each(connectivity, wanted, |number| {
            let node = number.index().map(|node| node.saturating_add(first as u64));
            node.map(|node| grid.nodes.push(node)).is_some()
        })?;
        let (mut point, mut filled) = ([0.0; 3], 0);
        let wanted = Wanted::exactly(
            points.saturating_mul(3),
            "coordinates, three for each point,",
        );
        self.each(coordinates, wanted, |number| {
            point[filled] = number.real();
            filled = (filled + 1) % 3;
            if filled == 0 {
                grid.points.push(point);
            }
            true
        })?;
        Ok(())
    }

    /// Reads the regions of all pieces, from the best array that has nothing else.
    fn regions(&self, pieces: &[Node<'d, 'd>], grid: &mut Grid) -> Result<(), MeshError> {
        while let Some(name) = grid.arrays.taken().map(str::to_owned) {
            let (mut regions, mut is_passed) = (Vec::new(), false);
            for piece in pieces {
                let cells = self.count(*piece, "NumberOfCells")?;
                let is_it = |array: &Node<'_, '_>| {
                    let head = head(*array);
                    head.width == 1 && head.name == name
                };
                if let Some(array) = arrays(*piece, "CellData").find(is_it) {
                    self.each(array, Wanted::exactly(cells, "regions"), |number| {
                        let region = number.region();
                        is_passed |= region.is_none();
                        regions.push(region.unwrap_or(0));
                        region.is_some() || !grid.arrays.is_named()
                    })?;
                } else {
                    // As many as there are types.
                    regions.resize(regions.len() + cells as usize, 0);
                }
            }
            if !is_passed {
                grid.regions = regions;
                break;
            }
            grid.arrays.pass_over();
        }
        Ok(())
    }

    fn disagree(&self, node: Node<'_, '_>, wanted: Wanted<'_>, found: u64) -> MeshError {
        let expected = format!("{} {} as announced", wanted.count, wanted.what);
        self.expected(node, &expected, &found.to_string())
    }

    /// Calls `take` with each number, which says whether it is one that may stand there.
    fn each(
        &self,
        node: Node<'d, 'd>,
        wanted: Wanted<'_>,
        mut take: impl FnMut(Number) -> bool,
    ) -> Result<(), MeshError> {
        let name = node.attribute("Name").unwrap_or("Points");
        let mut number = |number: Option<Number>, text: &dyn Fn() -> String| {
            let taken = number.is_some_and(&mut take);
            let expected = format!("a number that may stand in the array {name}");
            match taken {
                true => Ok(()),
                false => Err(self.expected(node, &expected, &text())),
            }
        };
        let most = usize::try_from(wanted.count).unwrap_or(usize::MAX);
        let found = match self.values(node, wanted)? {
            Values::Words(text) => {
                let mut words = text.split_ascii_whitespace();
                let mut found = 0;
                for word in words.by_ref().take(most) {
                    number(Number::parse(word), &|| word.to_owned())?;
                    found += 1;
                }
                found + words.count() as u64
            }
            Values::Bytes(bytes, kind, found) => {
                for chunk in bytes.chunks_exact(kind.size()) {
                    let read = kind.read(chunk, self.layout.endian);
                    number(Some(read), &|| format!("{read:?}"))?;
                }
                found
            }
        };
        match found == wanted.count || (found > wanted.count && !wanted.exact) {
            true => Ok(()),
            false => Err(self.disagree(node, wanted, found)),
        }
    }

    fn values(&self, node: Node<'d, 'd>, wanted: Wanted<'_>) -> Result<Values<'d>, MeshError> {
        let text = node.text().unwrap_or("").trim();
        let kind = match node.attribute("type") {
            Some("Int8") => Kind::I8,
            Some("UInt8") => Kind::U8,
            Some("Int16") => Kind::I16,
            Some("UInt16") => Kind::U16,
            Some("Int32") => Kind::I32,
            Some("UInt32") => Kind::U32,
            Some("Int64") => Kind::I64,
            Some("UInt64") => Kind::U64,
            Some("Float32") => Kind::F32,
            Some("Float64") => Kind::F64,
            other => {
                return Err(self.expected(node, "a type such as Float64", other.unwrap_or("")));
            }
        };
        let mut stream = match node.attribute("format") {
            None | Some("ascii") => return Ok(Values::Words(text)),
            Some("binary") => Stream {
                rest: text.as_bytes(),
                is_base64: true,
                pending: Vec::new(),
            },
            Some("appended") => {
                let offset = self.count(node, "offset")?;
                let start = usize::try_from(offset).unwrap_or(usize::MAX);
                let rest = self.appended.get(start..);
                Stream {
                    rest: rest.ok_or_else(|| self.cut_off(node, "the appended bytes"))?,
                    is_base64: self.layout.is_base64,
                    pending: Vec::new(),
                }
            }
            Some(other) => {
                return Err(self.expected(node, "a format of ascii, binary or appended", other));
            }
        };
        let cut_off = || self.cut_off(node, "all bytes, packed as the file says,");
        let blocks = self.blocks(&mut stream).ok_or_else(cut_off)?;
        if !blocks.bytes.is_multiple_of(kind.size() as u64) {
            return Err(self.cut_off(node, "a whole number of numbers"));
        }
        let found = blocks.bytes / kind.size() as u64;
        if found < wanted.count || (found > wanted.count && wanted.exact) {
            return Err(self.disagree(node, wanted, found));
        }
        let room = self
            .room
            .get()
            .checked_sub(wanted.count.saturating_mul(A_NUMBER));
        self.room.set(room.ok_or(MeshError::Unpacked {
            at: self.place(node),
            most: self.most,
        })?);
        let needed = usize::try_from(wanted.count).unwrap_or(usize::MAX);
        let needed = needed.saturating_mul(kind.size());
        let bytes = blocks.unpack(&mut stream, needed).ok_or_else(cut_off)?;
        Ok(Values::Bytes(bytes, kind, found))
    }

    /// A number of a header.
    fn size(&self, stream: &mut Stream<'_>) -> Option<usize> {
        let bytes = stream.take(self.layout.header.size())?;
        let number = self.layout.header.read(&bytes, self.layout.endian);
        number.index().and_then(|size| usize::try_from(size).ok())
    }

    /// The header of an array. Compressed: number of blocks, size of each and of the last before packing, packed sizes. Else how
    /// many bytes follow.
    fn blocks(&self, stream: &mut Stream<'_>) -> Option<Blocks> {
        if !self.layout.is_compressed {
            let bytes = self.size(stream)? as u64;
            return Some(Blocks {
                bytes,
                size: 0,
                packed: None,
            });
        }
        let [blocks, size, last] = [(); 3].map(|()| self.size(stream));
        let (blocks, size, last) = (blocks?, size?, last?);
        let packed: Option<Vec<usize>> = (0..blocks).map(|_| self.size(stream)).collect();
        stream.pending.clear();
        let whole = if last > 0 {
            blocks.saturating_sub(1)
        } else {
            blocks
        };
        let of_last = if blocks > 0 { last } else { 0 };
        let bytes = (size as u64)
            .checked_mul(whole as u64)?
            .checked_add(of_last as u64)?;
        Some(Blocks {
            bytes,
            size,
            packed: Some(packed?),
        })
    }
}

/// What the header of an array says.
struct Blocks {
    /// Bytes of all that follows, unpacked.
    bytes: u64,
    /// Bytes of each block but the last, unpacked.
    size: usize,
    /// Packed bytes of each block; none where it is not compressed.
    packed: Option<Vec<usize>>,
}

impl Blocks {
    /// The first bytes; those of a block are unpacked no further than its size says, and than is needed.
    fn unpack(&self, stream: &mut Stream<'_>, needed: usize) -> Option<Vec<u8>> {
        let Some(packed) = &self.packed else {
            return stream.take(needed);
        };
        let mut bytes = Vec::new();
        for packed in packed {
            let left = needed.checked_sub(bytes.len())?;
            if left == 0 {
                break;
            }
            let before = bytes.len();
            let of_block = usize::try_from(self.bytes).map_or(self.size, |all| {
                if self.size == 0 {
                    all
                } else {
                    self.size.min(all - before)
                }
            });
            let wanted = of_block.min(left);
            let chunk = stream.take(*packed)?;
            let mut decoder = ZlibDecoder::new(&chunk[..]).take(wanted as u64);
            decoder.read_to_end(&mut bytes).ok()?;
            if bytes.len() != before + wanted {
                return None;
            }
        }
        (bytes.len() == needed).then_some(bytes)
    }
}

/// Bytes, or base64 of them. Several texts of base64 may follow each other, each padded.
struct Stream<'d> {
    rest: &'d [u8],
    is_base64: bool,
    /// Decoded already.
    pending: Vec<u8>,
}

impl Stream<'_> {
    /// The next bytes; `None` where there are not so many.
    fn take(&mut self, count: usize) -> Option<Vec<u8>> {
        if !self.is_base64 {
            let (taken, rest) = self.rest.split_at_checked(count)?;
            self.rest = rest;
            return Some(taken.to_vec());
        }
        if count > self.rest.len() + self.pending.len() {
            return None;
        }
        while self.pending.len() < count {
            let (mut four, mut filled) = ([0; 4], 0);
            while filled < 4 {
                let (&first, rest) = self.rest.split_first()?;
                self.rest = rest;
                if !first.is_ascii_whitespace() {
                    four[filled] = first;
                    filled += 1;
                }
            }
            let mut three = [0; 3];
            let length = STANDARD.decode_slice(four, &mut three).ok()?;
            self.pending.extend_from_slice(&three[..length]);
        }
        let after = self.pending.split_off(count);
        Some(std::mem::replace(&mut self.pending, after))
    }
}
