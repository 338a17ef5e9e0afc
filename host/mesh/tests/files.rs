//! Mesh files that other programs wrote, `tests/data/meshes`, and what is left of them when they break.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use flate2::Compression;
use flate2::write::ZlibEncoder;
use serde_json::Value;
use std::collections::BTreeMap;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use sutura_mesh::{RawMesh, SurfaceFormat, read_raw_mesh, read_raw_mesh_with};

/// Each file, and whether it has the names of its regions.
const FILES: [(&str, bool); 18] = [
    ("gmsh22-ascii.msh", true),
    ("gmsh22-binary.msh", true),
    ("gmsh41-ascii.msh", true),
    ("gmsh41-binary.msh", true),
    ("gmsh41-order2.msh", true),
    ("gmsh.mesh", false),
    ("gmsh.inp", true),
    ("meshio.node", false),
    ("meshio42-ascii.vtk", false),
    ("meshio42-binary.vtk", false),
    ("vtk51-ascii.vtk", false),
    ("vtk51-binary.vtk", false),
    ("meshio.vtu", false),
    ("vtk-ascii.vtu", false),
    ("vtk-base64.vtu", false),
    ("vtk-base64-zlib.vtu", false),
    ("vtk-raw.vtu", false),
    ("vtk-raw-zlib.vtu", false),
];

fn path(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../tests/data/meshes")
        .join(name)
}

fn bytes(name: &str) -> Vec<u8> {
    std::fs::read(path(name)).expect(name)
}

/// Corners of a cell in a thousandth of the file's unit, from the least to the largest.
fn key(corners: [[f64; 3]; 4]) -> Vec<[i64; 3]> {
    let mut key: Vec<_> = corners
        .iter()
        .map(|at| at.map(|x| (1e3 * x).round() as i64))
        .collect();
    key.sort_unstable();
    key
}

/// The region of each cell of the model, by its corners: what gmsh held in memory.
fn reference() -> BTreeMap<Vec<[i64; 3]>, i64> {
    let json: Value = serde_json::from_slice(&bytes("reference.json")).expect("JSON");
    let cells: Vec<[[f64; 3]; 4]> =
        serde_json::from_value(json["cells"].clone()).expect("corners of cells");
    let regions: Vec<i64> = serde_json::from_value(json["regions"].clone()).expect("regions");
    cells.into_iter().map(key).zip(regions).collect()
}

/// 7 and 9, or 1 and 2 where a format has names alone.
fn group(mesh: &RawMesh, region: i64) -> i64 {
    match mesh.region_names.get(&region).map(String::as_str) {
        Some("liver") => 7,
        Some("fat") => 9,
        _ => region,
    }
}

#[test]
fn files_of_other_programs_have_the_same_nodes_cells_and_regions() {
    let reference = reference();
    assert_eq!(reference.len(), 218);
    for (name, has_names) in FILES
        .into_iter()
        .chain([("vtk-appended-base64-zlib.vtu", false)])
    {
        let mesh =
            read_raw_mesh(&path(name), 1.0).unwrap_or_else(|error| panic!("{name}: {error}"));
        assert_eq!(mesh.points_m.len(), 84, "{name}");
        let mut read = BTreeMap::new();
        for (cell, region) in mesh.cells.iter().zip(&mesh.regions) {
            let corners = cell.map(|node| mesh.points_m[node as usize]);
            read.insert(key(corners), group(&mesh, *region));
        }
        assert_eq!(mesh.cells.len(), reference.len(), "{name}");
        assert!(read == reference, "{name}: other cells or regions");
        let names: Vec<_> = mesh.region_names.values().map(String::as_str).collect();
        let wanted: &[&str] = if has_names { &["liver", "fat"] } else { &[] };
        assert_eq!(names, wanted, "{name}");
        let is_second_order = name.contains("order2");
        let says = |words: &str| mesh.notes.iter().any(|note| note.contains(words));
        assert_eq!(
            says("218 cells of 10 nodes"),
            is_second_order,
            "{name}: {:?}",
            mesh.notes
        );
        assert!(
            !is_second_order || says("every edge is straight"),
            "{:?}",
            mesh.notes
        );
        let has_faces = name.starts_with("gmsh");
        assert_eq!(
            says("lines and faces are left out"),
            has_faces,
            "{name}: {:?}",
            mesh.notes
        );
        mesh.scaled(1e-3)
            .and_then(RawMesh::check)
            .unwrap_or_else(|error| panic!("{name}: {error}"));
    }
}

/// Reads and checks a file of these bytes; the error's text, and the most memory \[bytes\] that was taken for it.
fn broken(name: &str, bytes: &[u8]) -> (Option<String>, u64) {
    let mut error = None;
    let memory = allocation_counter::measure(|| {
        let read = |path: &Path| match path.extension() {
            // The other half of a mesh of tetgen is whole.
            Some(extension) if extension == "ele" && !name.ends_with("ele") => file("meshio.ele"),
            Some(extension) if extension == "node" && name.ends_with("ele") => file("meshio.node"),
            _ => Ok(bytes.to_vec()),
        };
        let mesh = read_raw_mesh_with(Path::new(name), 1.0, None, read);
        error = mesh
            .and_then(RawMesh::check)
            .err()
            .map(|error| error.to_string());
    });
    (error, memory.bytes_max)
}

fn file(name: &str) -> std::io::Result<Vec<u8>> {
    std::fs::read(path(name))
}

/// A wrong file may take no more memory than this \[bytes\].
const MOST_MEMORY: u64 = 20_000_000;

#[test]
fn files_that_are_cut_off_are_refused() {
    let mut count = 0;
    for (name, _) in FILES.into_iter().chain([("meshio.ele", false)]) {
        let whole = bytes(name);
        // An `.inp` says neither how much there is nor where it ends: what is missing of its last sets nobody can see.
        let parts: &[usize] = if name.ends_with("inp") {
            &[1, 3]
        } else {
            &[1, 3, 5, 7]
        };
        for part in parts {
            let kept = whole.len() * part / 8;
            let (error, memory) = broken(name, &whole[..kept]);
            let error =
                error.unwrap_or_else(|| panic!("{name} is read from its first {kept} bytes"));
            assert!(
                error.len() > 20 && memory < MOST_MEMORY,
                "{name}: {error}, {memory} bytes"
            );
            count += 1;
        }
    }
    assert_eq!(count, 74);
}

/// At any byte: never more memory, and no panic.
#[test]
fn files_that_are_cut_or_changed_anywhere_are_read_or_refused() {
    let mut random = 0x2545_f491_4f6c_dd1d_u64;
    let mut next = |below: usize| {
        random ^= random << 13;
        random ^= random >> 7;
        random ^= random << 17;
        (random % below as u64) as usize
    };
    let mut refused = 0;
    for (name, _) in FILES.into_iter().chain([("meshio.ele", false)]) {
        let whole = bytes(name);
        for change in 0..150 {
            let mut bytes = whole.clone();
            match change % 3 {
                0 => bytes.truncate(next(whole.len())),
                1 => bytes[next(whole.len())] ^= 1 << next(8),
                // Four bytes of ones: a huge count in any coding of bytes.
                _ => {
                    let at = next(whole.len() - 4);
                    bytes[at..at + 4].fill(if name.contains("binary") { 0x7f } else { b'9' });
                }
            }
            let (error, memory) = broken(name, &bytes);
            assert!(memory < MOST_MEMORY, "{name}: {memory} bytes, {error:?}");
            refused += u32::from(error.is_some());
        }
    }
    assert!(refused > 1000, "{refused}");
}

/// What one change makes of a file of text, and what the error says.
const BROKEN: &[(&str, &str, &str, &[&str])] = &[
    (
        "gmsh22-ascii.msh",
        "$Nodes\n84",
        "$Nodes\n99999999999",
        &["line", "a node: number x y z"],
    ),
    (
        "gmsh22-ascii.msh",
        "$Nodes\n84",
        "$Nodes\n-1",
        &["line", "number of nodes", "-1"],
    ),
    (
        "gmsh22-ascii.msh",
        "2.2 0 8",
        "1.0 0 8",
        &["line 2", "gmsh format 1.0"],
    ),
    (
        "gmsh22-ascii.msh",
        " 4 2 9 ",
        " 5 2 9 ",
        &["element 291", "5 of gmsh", "8-node hexahedron"],
    ),
    (
        "gmsh22-ascii.msh",
        " 4 2 9 ",
        " 999 2 9 ",
        &["999 of gmsh", "no type that is known"],
    ),
    (
        "gmsh22-ascii.msh",
        " 4 2 9 ",
        " 4 99999999999 9 ",
        &["line", "the end of the line"],
    ),
    (
        "gmsh22-ascii.msh",
        "$EndNodes",
        "$EndKnots",
        &["line", "$EndNodes", "$EndKnots"],
    ),
    (
        "gmsh22-binary.msh",
        "$Nodes\n84",
        "$Nodes\n9999999999",
        &["byte", "node"],
    ),
    (
        "gmsh22-binary.msh",
        "2.2 1 8",
        "2.2 1 4",
        &["numbers of 4 bytes"],
    ),
    (
        "gmsh22-binary.msh",
        "2.2 1 8",
        "2.2 7 8",
        &["0 for text, 1 for bytes", "7"],
    ),
    (
        "gmsh41-ascii.msh",
        "4.1 0 8",
        "4.0 0 8",
        &["gmsh format 4.0", "msh41"],
    ),
    (
        "gmsh41-ascii.msh",
        "$Elements",
        "$Elephants",
        &["$EndElephants"],
    ),
    (
        "gmsh41-ascii.msh",
        "$EndElements",
        "$EndElephants",
        &["$EndElements"],
    ),
    (
        "gmsh41-order2.msh",
        "4.1 0 8",
        "4.1 0 eight",
        &["line 2", "eight"],
    ),
    (
        "gmsh.mesh",
        "MeshVersionFormatted",
        "MeshVersion",
        &["line 1", ".meshb"],
    ),
    ("gmsh.mesh", " 3\n", " 2\n", &["dimension 3", "2"]),
    (
        "gmsh.mesh",
        " Vertices\n 84",
        " Vertices\n 9999999999999",
        &["line", "coordinates"],
    ),
    (
        "gmsh.mesh",
        " Tetrahedra\n 218",
        " Tetrahedra\n 9999999999999",
        &["line", "a node of a cell"],
    ),
    ("gmsh.mesh", " Tetrahedra", " Hexahedra", &["hexahedron"]),
    ("gmsh.mesh", " Tetrahedra", " Triangles", &["no Tetrahedra"]),
    ("gmsh.inp", "C3D4", "C3D8R", &["C3D8R", "hexahedron"]),
    ("gmsh.inp", "C3D4", "C3D10", &["10 nodes", "4 nodes"]),
    ("gmsh.inp", "*NODE", "*KNOT", &["no *NODE"]),
    ("gmsh.inp", "type=C3D4", "kind=C3D4", &["TYPE such as C3D4"]),
    (
        "gmsh.inp",
        "1, 0, 0, 20",
        "1, 0, x, 20",
        &["line 4", "a node: number, x, y, z"],
    ),
    (
        "gmsh.inp",
        "1, 0, 0, 20",
        "2, 0, 0, 20",
        &["line 5", "node 2 is given twice"],
    ),
    (
        "gmsh.inp",
        "*Heading",
        "*Include, input=a.inp",
        &["*INCLUDE", "in its place"],
    ),
    ("meshio.node", "84 3", "84 2", &[".node", "dimension 3"]),
    (
        "meshio.node",
        "84 3",
        "99999999999 3",
        &[".node", "cut off"],
    ),
    ("meshio.ele", "218 4", "218 8", &[".ele", "4 or 10 nodes"]),
    ("meshio.ele", "218 4", "99999999999 4", &[".ele", "cut off"]),
    (
        "meshio.ele",
        "218 4 1",
        "218 4 99999999999",
        &[".ele", "the end of the line"],
    ),
    (
        "meshio42-ascii.vtk",
        "POINTS 84",
        "POINTS 99999999999",
        &["line", "coordinate"],
    ),
    (
        "meshio42-ascii.vtk",
        "UNSTRUCTURED_GRID",
        "POLYDATA",
        &["UNSTRUCTURED_GRID", "POLYDATA"],
    ),
    (
        "meshio42-binary.vtk",
        "POINTS 84",
        "POINTS 99999999999",
        &["byte", "cut off"],
    ),
    (
        "meshio42-binary.vtk",
        "CELL_TYPES 218",
        "CELL_TYPES 999999999",
        &["byte", "cut off"],
    ),
    (
        "meshio42-binary.vtk",
        "BINARY",
        "OCTAL",
        &["ASCII or BINARY", "OCTAL"],
    ),
    (
        "vtk51-ascii.vtk",
        "OFFSETS vtktypeint64",
        "OFFSETS vtktypeword",
        &["vtktypeword"],
    ),
    (
        "vtk51-ascii.vtk",
        "CELLS 219",
        "CELLS 999999999",
        &["an offset"],
    ),
    (
        "vtk51-binary.vtk",
        "CELLS 219 872",
        "CELLS 219 99999999999",
        &["byte", "cut off"],
    ),
    (
        "vtk-ascii.vtu",
        "NumberOfPoints=\"84\"",
        "NumberOfPoints=\"99999999999\"",
        &["299999999997 coordinates", "as announced", "252"],
    ),
    (
        "vtk-ascii.vtu",
        "NumberOfCells=\"218\"",
        "NumberOfCells=\"many\"",
        &["NumberOfCells", "many"],
    ),
    (
        "vtk-ascii.vtu",
        "UnstructuredGrid\"",
        "PolyData\"",
        &["line 1", "PolyData"],
    ),
    (
        "vtk-ascii.vtu",
        "Name=\"types\"",
        "Name=\"kinds\"",
        &["no types"],
    ),
    (
        "vtk-ascii.vtu",
        "type=\"Int64\"",
        "type=\"Int65\"",
        &["line", "Int65"],
    ),
    (
        "vtk-base64.vtu",
        "BigEndian",
        "MiddleEndian",
        &["LittleEndian or BigEndian"],
    ),
    (
        "vtk-base64-zlib.vtu",
        "vtkZLibDataCompressor",
        "vtkLZMADataCompressor",
        &["line 1", "vtkLZMADataCompressor", "vtkZLibDataCompressor"],
    ),
    (
        "vtk-base64-zlib.vtu",
        "UInt64\" compressor",
        "UInt65\" compressor",
        &["UInt65"],
    ),
    (
        "vtk-raw.vtu",
        "offset=\"13392\"",
        "offset=\"99999999999\"",
        &["line", "appended bytes"],
    ),
    (
        "vtk-raw.vtu",
        "<AppendedData encoding=\"raw\">",
        "<AppendedData encoding=\"cooked\">",
        &["raw or base64", "cooked"],
    ),
    (
        "vtk-raw-zlib.vtu",
        " compressor=\"vtkZLibDataCompressor\"",
        "",
        &["218 types as announced"],
    ),
];

#[test]
fn what_is_wrong_is_named_by_its_place() {
    for (name, from, to, said) in BROKEN {
        let whole = bytes(name);
        let at = whole
            .windows(from.len())
            .position(|window| window == from.as_bytes());
        let Some(at) = at else {
            panic!("{name} has no {from:?}")
        };
        let mut bytes = whole[..at].to_vec();
        bytes.extend(to.as_bytes());
        bytes.extend(&whole[at + from.len()..]);
        let (error, memory) = broken(name, &bytes);
        let error = error.unwrap_or_else(|| panic!("{name} with {to:?} is read"));
        for words in *said {
            assert!(
                error.contains(words),
                "{name} with {to:?}: no {words} in: {error}"
            );
        }
        assert!(memory < MOST_MEMORY, "{name} with {to:?}: {memory} bytes");
    }
}

/// Of a list in a `.ply` no more is kept than a face can have corners, however long it is; a face of more is refused.
#[test]
fn long_lists_of_a_ply_take_no_memory() {
    const LONG: u32 = 1_000_000;
    let file = |list: &str| {
        let head = format!(
            "ply\nformat binary_little_endian 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n\
             element face 1\nproperty list uint uchar {list}\nproperty list uchar uchar vertex_index\nend_header\n"
        );
        let mut bytes = head.into_bytes();
        bytes.extend([0; 12]);
        bytes.extend(LONG.to_le_bytes());
        bytes.resize(bytes.len() + LONG as usize, 0);
        bytes.extend([3, 0, 0, 0]);
        bytes
    };
    for (list, said) in [
        ("more", None),
        (
            "vertex_indices",
            Some("a face of 3 to 1000 corners, found `more`"),
        ),
    ] {
        let bytes = file(list);
        let mut read = None;
        let memory = allocation_counter::measure(|| {
            read = Some(SurfaceFormat::Ply.read(&bytes, 1.0));
        });
        let error = read
            .expect("it was read")
            .err()
            .map(|error| error.to_string());
        assert!(
            memory.bytes_max < 1_000_000,
            "{list}: {} bytes",
            memory.bytes_max
        );
        match said {
            Some(said) => assert!(error.is_some_and(|error| error.contains(said)), "{list}"),
            None => assert_eq!(error, None, "{list}"),
        }
    }
}

/// A tetrahedron of ten nodes, one of them moved by a tenth of its edge, or to where no middle is.
#[test]
fn curved_edges_are_said_and_misplaced_mid_nodes_refused() {
    let file = |x: f64| {
        format!(
            "MeshVersionFormatted 2\nDimension 3\nVertices 10\n0 0 0 1\n1 0 0 1\n0 1 0 1\n0 0 1 1\n\
             {x} 0 0 1\n0.5 0.5 0 1\n0 0.5 0 1\n0 0 0.5 1\n0.5 0 0.5 1\n0 0.5 0.5 1\n\
             TetrahedraP2 1\n1 2 3 4 5 6 7 8 9 10 4\nEnd\n"
        )
    };
    let read = |x| read_raw_mesh_with(Path::new("a.mesh"), 1.0, None, |_| Ok(file(x).into_bytes()));
    let straight = read(0.5).expect("a mesh");
    assert_eq!((straight.points_m.len(), straight.regions[0]), (4, 4));
    assert!(
        straight.notes[0].contains("6 nodes in the middle"),
        "{:?}",
        straight.notes
    );
    let curved = read(0.6).expect("a mesh");
    let note = &curved.notes[0];
    assert!(
        note.contains("1 cells have curved edges") && note.contains("10.0 %"),
        "{note}"
    );
    let error = read(2.0).expect_err("no middle").to_string();
    assert!(
        error.contains("element 1 (") && error.contains("middle of the edge"),
        "{error}"
    );
}

#[test]
fn cleaning_drops_unused_nodes_turns_cells_and_keeps_regions() {
    let mut mesh = read_raw_mesh(&path("gmsh41-binary.msh"), 1e-3).expect("a mesh");
    let sound = mesh.clone();
    for cell in mesh.cells.iter_mut().step_by(3) {
        cell.swap(0, 1);
    }
    mesh.points_m.insert(0, [1.0; 3]);
    mesh.points_m.push([2.0; 3]);
    for node in mesh.cells.iter_mut().flatten() {
        *node += 1;
    }
    let done = mesh.clean();
    assert_eq!((done.dropped_nodes, done.turned_cells), (2, 73));
    assert_eq!(
        (&mesh.points_m, &mesh.regions),
        (&sound.points_m, &sound.regions)
    );
    let volume = |mesh: &RawMesh| {
        let report = sutura_mesh::MeshReport::of(mesh).expect("a report");
        (report.inverted, report.volume_m3)
    };
    assert_eq!(volume(&mesh).0, 0);
    assert!((volume(&mesh).1 - volume(&sound).1).abs() < 1e-18);
    assert!(mesh.check().is_ok());
}

/// Attributes without end are refused before the parser compares each with each; `=` in values and text are none.
#[test]
fn an_element_with_attributes_without_end_is_refused() {
    let element = |count: u32, value: &str| {
        let attributes: Vec<_> = (0..count).map(|n| format!("a{n}=\"{value}\"")).collect();
        format!(
            "<VTKFile>\n<DataArray {}/>==</VTKFile>",
            attributes.join("\n")
        )
    };
    let said = |text: String| broken("a.vtu", text.as_bytes()).0.expect("no mesh");
    let refused = said(element(100_000, "1"));
    assert!(
        refused.contains("line 1002") && refused.contains("at most 1000 attributes"),
        "{refused}"
    );
    for good in [element(1_000, "1"), element(900, "<a='>' b==>")] {
        let other = said(good);
        assert!(!other.contains("attributes"), "{other}");
    }
}

/// An array of `.vtu` as base64, packed in blocks of a mebibyte.
fn packed(kind: &str, name: &str, bytes: &[u8]) -> String {
    const BLOCK: usize = 1 << 20;
    let blocks = bytes.chunks(BLOCK).map(|block| {
        let mut encoder = ZlibEncoder::new(Vec::new(), Compression::best());
        encoder.write_all(block).expect("memory");
        encoder.finish().expect("memory")
    });
    let blocks: Vec<Vec<u8>> = blocks.collect();
    let sizes = blocks.iter().map(Vec::len);
    let header: Vec<u8> = [blocks.len(), BLOCK, bytes.len() % BLOCK]
        .into_iter()
        .chain(sizes)
        .flat_map(|number| (number as u32).to_le_bytes())
        .collect();
    format!(
        "<DataArray type=\"{kind}\" Name=\"{name}\" format=\"binary\">{}{}</DataArray>",
        STANDARD.encode(header),
        STANDARD.encode(blocks.concat())
    )
}

fn whole(numbers: impl IntoIterator<Item = i64>) -> Vec<u8> {
    numbers.into_iter().flat_map(i64::to_le_bytes).collect()
}

/// A `.vtu` with one piece of these parts.
fn vtu(points: u64, cells: u64, parts: &[(&str, String)]) -> Vec<u8> {
    let parts: String = parts
        .iter()
        .map(|(part, arrays)| format!("<{part}>{arrays}</{part}>"))
        .collect();
    format!(
        "<VTKFile type=\"UnstructuredGrid\" byte_order=\"LittleEndian\" compressor=\"vtkZLibDataCompressor\"><UnstructuredGrid>\
        <Piece NumberOfPoints=\"{points}\" NumberOfCells=\"{cells}\">{parts}</Piece></UnstructuredGrid></VTKFile>"
    )
    .into_bytes()
}

/// Some kilobytes that unpack to a hundred megabytes: what is missing is said before, and there is a limit.
#[test]
fn packed_arrays_are_unpacked_no_further_than_cells_need() {
    const NODES: u64 = 5_000_000;
    let points = packed("Float64", "Points", &vec![0; 24 * NODES as usize]);
    let ends = packed("Int64", "offsets", &whole([4]));
    let types = packed("UInt8", "types", &[10]);
    let nodes = packed("Int64", "connectivity", &whole([0, 1, 2, 3]));
    for (nodes_said, cells, said) in [
        (NODES, format!("{ends}{types}"), "no connectivity"),
        (4, format!("{nodes}{ends}{types}"), "12 coordinates"),
        (
            NODES,
            format!("{nodes}{ends}{types}"),
            "packed arrays take more than",
        ),
    ] {
        let parts = [("Points", points.clone()), ("Cells", cells)];
        let bytes = vtu(nodes_said, 1, &parts);
        assert!(bytes.len() < 400_000, "{}", bytes.len());
        let (error, memory) = broken("a.vtu", &bytes);
        let error = error.expect("refused");
        assert!(error.contains(said), "no {said} in: {error}");
        assert!(memory < MOST_MEMORY, "{said}: {memory} bytes");
    }
    // Nodes behind those of the cells are not unpacked either.
    let more = packed("Int64", "connectivity", &vec![0; 8 * NODES as usize]);
    let corners = [
        0.0f64, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0,
    ];
    let corners: Vec<u8> = corners.into_iter().flat_map(f64::to_le_bytes).collect();
    let parts = [
        ("Points", packed("Float64", "Points", &corners)),
        ("Cells", format!("{more}{ends}{types}")),
    ];
    let (error, memory) = broken("a.vtu", &vtu(4, 1, &parts));
    assert!(error.expect("one node four times").contains("twice"));
    assert!(memory < MOST_MEMORY, "{memory} bytes");
}

/// An array with the name of one of regions and other numbers shuts no `.vtu` out, and one of whole numbers is read in its place.
#[test]
fn arrays_of_fractions_are_no_regions() {
    let array = |kind: &str, name: &str, text: &str| {
        format!("<DataArray type=\"{kind}\" Name=\"{name}\">{text}</DataArray>")
    };
    let cells = [
        array("Int32", "connectivity", "0 1 2 3 1 2 3 4"),
        array("Int32", "offsets", "4 8"),
        array("UInt8", "types", "10 10"),
    ];
    let corners = "0 0 0 1 0 0 0 1 0 0 0 1 1 1 1";
    let heat = array("Float32", "material", "0.5 2");
    let none = array("Float64", "tissue", "nan 1");
    let packed = |name: &str, values: [f64; 2]| {
        let bytes: Vec<u8> = values.into_iter().flat_map(f64::to_le_bytes).collect();
        packed("Float64", name, &bytes)
    };
    for (data, regions) in [
        (heat.clone(), [0, 0]),
        (packed("region", [1.0, 0.25]), [0, 0]),
        (
            [heat.clone(), none, array("Int16", "labels", "3 4")].concat(),
            [3, 4],
        ),
        (
            [packed("region", [1.0, 0.25]), packed("mat", [7.0, 8.0])].concat(),
            [7, 8],
        ),
    ] {
        let parts = [
            ("CellData", data.clone()),
            ("Points", array("Float64", "Points", corners)),
            ("Cells", cells.concat()),
        ];
        let bytes = vtu(5, 2, &parts);
        let read =
            |name| read_raw_mesh_with(Path::new("a.vtu"), 1.0, name, |_: &Path| Ok(bytes.clone()));
        let mesh = read(None).expect("a good file");
        assert_eq!(mesh.regions, regions, "{data}");
        let told = mesh.notes.join("\n");
        assert!(
            told.contains("numbers that are not whole: it is passed over"),
            "{told}"
        );
    }
}

/// Regions of `.vtu` by the array's name; pieces that have none are in region 0.
#[test]
fn regions_are_those_of_a_named_array() {
    let corners = "0 0 0 1 0 0 0 1 0 0 0 1 1 1 1";
    let array = |kind: &str, name: &str, text: &str| {
        format!("<DataArray type=\"{kind}\" Name=\"{name}\">{text}</DataArray>")
    };
    let cells = [
        array("Int32", "connectivity", "0 1 2 3 1 2 3 4"),
        array("Int32", "offsets", "4 8"),
        array("UInt8", "types", "10 10"),
    ];
    let data = [
        array("Int32", "my_ids", "5 6"),
        array("Float32", "heat", "1.5 2.5"),
        array("Int16", "mat_id", "3 4"),
    ];
    let bytes = vtu(
        5,
        2,
        &[
            ("CellData", data.concat()),
            ("Points", array("Float64", "Points", corners)),
            ("Cells", cells.concat()),
        ],
    );
    let read =
        |name| read_raw_mesh_with(Path::new("a.vtu"), 1.0, name, |_: &Path| Ok(bytes.clone()));
    let mesh = read(None).expect("sound");
    assert_eq!(mesh.regions, [3, 4]);
    let told = mesh.notes.join("\n");
    for words in ["cell array `mat_id`", "--region my_ids"] {
        assert!(told.contains(words), "{words}: {told}");
    }
    assert!(!told.contains("heat"), "{told}");
    assert_eq!(read(Some("my_ids")).expect("sound").regions, [5, 6]);
    let said = read(Some("heat"))
        .expect_err("no whole numbers")
        .to_string();
    assert!(said.contains("heat"), "{said}");
    let said = read(Some("labels")).expect_err("none").to_string();
    assert!(
        said.contains("`labels`") && said.contains("my_ids, heat, mat_id"),
        "{said}"
    );
    let other = |_: &Path| Ok(Vec::new());
    let said = read_raw_mesh_with(Path::new("a.msh"), 1.0, Some("labels"), other);
    assert!(
        said.expect_err("no arrays")
            .to_string()
            .contains("`labels`")
    );
}
