//! Reads VTK's XML, `.vtu`: arrays as text, base64 or raw bytes, inline or appended, plain or compressed by zlib.
//!
//! Entry point: [`read_vtu`]. Format: VTK File Formats, "XML File Formats". Nothing is set aside for a count that the
//! file announces; a block is unpacked no further than its size says.

use super::super::{MeshError, Place, RawMesh};
use super::names_regions;
use super::scan::{Endian, Kind, Number, no_text};
use super::vtk::Grid;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use flate2::read::ZlibDecoder;
use roxmltree::{Document, Node};
use std::io::Read;

/// Reads a file, in its own unit of length. A cell array named as in `REGION_NAMES` gives the regions.
///
/// # Errors
/// A [`MeshError`] with the line of the array; volume cells other than tetrahedra are refused.
pub(super) fn read_vtu(bytes: &[u8]) -> Result<RawMesh, MeshError> {
    let (text, appended) = split(bytes)?;
    let document = Document::parse(&text).map_err(|error| MeshError::Syntax {
        at: Place::Line(error.pos().row as usize),
        expected: "XML that is whole; is the file cut off?".into(),
        found: error.to_string(),
    })?;
    let file = File {
        document: &document,
        appended,
        layout: Layout::of(&document)?,
    };
    let root = document.root_element();
    let mut grid = Grid::default();
    let mut has_piece = false;
    for piece in root.descendants().filter(|n| n.has_tag_name("Piece")) {
        has_piece = true;
        file.piece(piece, &mut grid)?;
    }
    if !has_piece {
        return Err(MeshError::NoSection("Piece"));
    }
    let end = file.place(root);
    grid.into_mesh(end)
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

struct File<'d> {
    document: &'d Document<'d>,
    appended: &'d [u8],
    layout: Layout,
}

/// The numbers of an array.
enum Values<'d> {
    Words(&'d str),
    Bytes(Vec<u8>, Kind),
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

    /// Adds the points, cells and regions of a piece.
    fn piece(&self, piece: Node<'d, 'd>, grid: &mut Grid) -> Result<(), MeshError> {
        let (points, cells) = (
            self.count(piece, "NumberOfPoints")?,
            self.count(piece, "NumberOfCells")?,
        );
        let first = grid.points.len();
        let array = |parent: &str, is: &dyn Fn(&str) -> bool| {
            let parent = piece.children().find(|n| n.has_tag_name(parent))?;
            let mut arrays = parent.children().filter(|n| n.has_tag_name("DataArray"));
            arrays.find(|n| is(n.attribute("Name").unwrap_or("")))
        };
        let need = |parent: &'static str, name: &'static str| {
            let node = array(parent, &|n| name.is_empty() || n == name);
            node.ok_or(MeshError::NoSection(if name.is_empty() {
                parent
            } else {
                name
            }))
        };
        let (mut point, mut filled) = ([0.0; 3], 0);
        let coordinates = need("Points", "")?;
        self.each(coordinates, |number| {
            point[filled] = number.real();
            filled = (filled + 1) % 3;
            if filled == 0 {
                grid.points.push(point);
            }
            true
        })?;
        self.agree(
            coordinates,
            (grid.points.len() - first) as u64,
            points,
            "points",
        )?;
        let start = grid.nodes.len();
        self.each(need("Cells", "connectivity")?, |number| {
            let node = number.index().map(|node| node.saturating_add(first as u64));
            node.map(|node| grid.nodes.push(node)).is_some()
        })?;
        let offsets = need("Cells", "offsets")?;
        let (mut last, cells_before) = (start, grid.ends.len());
        self.each(offsets, |number| {
            let offset = number.index().and_then(|end| usize::try_from(end).ok());
            let end = offset.and_then(|end| end.checked_add(start));
            end.filter(|end| *end >= last)
                .map(|end| {
                    last = end;
                    grid.ends.push(end);
                })
                .is_some()
        })?;
        self.agree(
            offsets,
            (grid.ends.len() - cells_before) as u64,
            cells,
            "offsets that ascend",
        )?;
        let types = need("Cells", "types")?;
        let (at, kinds_before) = (self.place(types), grid.kinds.len());
        self.each(types, |number| {
            number
                .index()
                .map(|kind| grid.kinds.push((kind, at)))
                .is_some()
        })?;
        self.agree(
            types,
            (grid.kinds.len() - kinds_before) as u64,
            cells,
            "types",
        )?;
        grid.regions.resize(cells_before, 0);
        if let Some(regions) = array("CellData", &names_regions) {
            self.each(regions, |number| {
                number
                    .region()
                    .map(|region| grid.regions.push(region))
                    .is_some()
            })?;
            let count = grid.regions.len() - cells_before;
            self.agree(regions, count as u64, cells, "regions")?;
        }
        Ok(())
    }

    fn agree(
        &self,
        node: Node<'_, '_>,
        found: u64,
        announced: u64,
        what: &str,
    ) -> Result<(), MeshError> {
        if found == announced {
            return Ok(());
        }
        let expected = format!("{announced} {what} as announced");
        Err(self.expected(node, &expected, &found.to_string()))
    }

    /// Calls `take` with each number, which says whether it is one that may stand there.
    fn each(
        &self,
        node: Node<'d, 'd>,
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
        match self.values(node)? {
            Values::Words(text) => {
                for word in text.split_ascii_whitespace() {
                    number(Number::parse(word), &|| word.to_owned())?;
                }
            }
            Values::Bytes(bytes, kind) => {
                let chunks = bytes.chunks_exact(kind.size());
                if !chunks.remainder().is_empty() {
                    return Err(self.cut_off(node, "a whole number of numbers"));
                }
                for chunk in chunks {
                    let read = kind.read(chunk, self.layout.endian);
                    number(Some(read), &|| format!("{read:?}"))?;
                }
            }
        }
        Ok(())
    }

    fn values(&self, node: Node<'d, 'd>) -> Result<Values<'d>, MeshError> {
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
        let bytes = match self.layout.is_compressed {
            true => self.unpack(&mut stream),
            false => {
                let size = self.size(&mut stream);
                size.and_then(|size| stream.take(size))
            }
        };
        let bytes =
            bytes.ok_or_else(|| self.cut_off(node, "all bytes, packed as the file says,"))?;
        Ok(Values::Bytes(bytes, kind))
    }

    /// A number of a header.
    fn size(&self, stream: &mut Stream<'_>) -> Option<usize> {
        let bytes = stream.take(self.layout.header.size())?;
        let number = self.layout.header.read(&bytes, self.layout.endian);
        number.index().and_then(|size| usize::try_from(size).ok())
    }

    /// Compressed: number of blocks, size of each and of the last before packing, packed sizes, the blocks.
    fn unpack(&self, stream: &mut Stream<'_>) -> Option<Vec<u8>> {
        let [blocks, size, last] = [(); 3].map(|()| self.size(stream));
        let (blocks, size, last) = (blocks?, size?, last?);
        let packed: Option<Vec<usize>> = (0..blocks).map(|_| self.size(stream)).collect();
        let packed = packed?;
        stream.pending.clear();
        let mut bytes = Vec::new();
        for (block, packed) in packed.into_iter().enumerate() {
            let is_last = block + 1 == blocks && last > 0;
            let wanted = if is_last { last } else { size };
            let end = bytes.len().checked_add(wanted)?;
            let chunk = stream.take(packed)?;
            let mut decoder = ZlibDecoder::new(&chunk[..]).take(wanted as u64);
            decoder.read_to_end(&mut bytes).ok()?;
            if bytes.len() != end {
                return None;
            }
        }
        Some(bytes)
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
