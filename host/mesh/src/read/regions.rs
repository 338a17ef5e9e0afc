//! Cell arrays that may have the regions of a mesh: which is taken, and what is said of the others.
//!
//! Entry points: [`RegionArrays::takes`] for each array of a file in turn, [`RegionArrays::end`].

use super::super::MeshError;

/// Names under which programs write the region of a cell: this one's, gmsh's, meshio's, pyvista's, VTK's.
const REGION_NAMES: [&str; 8] = [
    "region",
    "regions",
    "CellEntityIds",
    "gmsh:physical",
    "medit:ref",
    "material",
    "MaterialIds",
    "RegionId",
];

/// Names that come after those, without signs between letters: 3D Slicer's and Cleaver's, SfePy's, MFEM's, Exodus', meshio's
/// for formats of other programs, and the plain words.
const MORE_NAMES: [&str; 26] = [
    "label",
    "labels",
    "labelid",
    "mat",
    "matid",
    "matids",
    "materialid",
    "materials",
    "regionids",
    "attribute",
    "attributes",
    "subdomain",
    "subdomains",
    "subdomainid",
    "domainid",
    "blockid",
    "blockids",
    "elementblockids",
    "objectid",
    "tetgenref",
    "avsucdmaterial",
    "netgenindex",
    "flac3dgroup",
    "su2tag",
    "tissue",
    "tissueid",
];

/// A name without what writers put between its words.
fn plain(name: &str) -> String {
    let letters = name.chars().filter(|c| c.is_alphanumeric());
    letters.flat_map(char::to_lowercase).collect()
}

/// Head of a cell array.
#[derive(Clone, Copy, Debug)]
pub(super) struct Head<'a> {
    pub name: &'a str,
    /// Numbers for each cell.
    pub width: u64,
    /// Whether its type is of whole numbers.
    pub is_whole: bool,
}

/// Cell arrays of a file, as they come.
#[derive(Debug, Default)]
pub(super) struct RegionArrays {
    /// The name that the user gives.
    wanted: Option<String>,
    /// The array that has the regions so far, and how well its name fits: the least is the best.
    taken: Option<(String, u8)>,
    /// Others of whole numbers.
    unused: Vec<String>,
    /// All with a number for each cell.
    known: Vec<String>,
}

impl RegionArrays {
    pub fn new(wanted: Option<&str>) -> Self {
        Self {
            wanted: wanted.map(str::to_owned),
            ..Self::default()
        }
    }

    /// Rank of a name among those that regions have; none for another.
    fn rank(&self, name: &str) -> Option<u8> {
        if let Some(wanted) = &self.wanted {
            return (wanted == name).then_some(0);
        }
        if REGION_NAMES.iter().any(|n| n.eq_ignore_ascii_case(name)) {
            return Some(0);
        }
        MORE_NAMES.contains(&plain(name).as_str()).then_some(1)
    }

    /// Whether the regions are those of this array, in place of one that came before; of equals the first.
    pub fn takes(&mut self, array: Head<'_>) -> bool {
        if array.width != 1 {
            return false;
        }
        let name = array.name.to_owned();
        if !self.known.contains(&name) {
            self.known.push(name.clone());
        }
        let rank = self.rank(&name);
        let best = self.taken.as_ref().map(|(_, rank)| *rank);
        let is_better = rank.is_some_and(|rank| best.is_none_or(|best| rank < best));
        let other = match (is_better, rank) {
            (true, Some(rank)) => self.taken.replace((name, rank)).map(|(other, _)| other),
            _ => array.is_whole.then_some(name),
        };
        let is_taken = |name: &String| self.taken.as_ref().is_some_and(|(taken, _)| taken == name);
        self.unused
            .extend(other.filter(|name| !is_taken(name) && !self.unused.contains(name)));
        is_better
    }

    /// The name of the array that has the regions.
    pub fn taken(&self) -> Option<&str> {
        self.taken.as_ref().map(|(name, _)| name.as_str())
    }

    /// Notes about the arrays.
    ///
    /// # Errors
    /// [`MeshError::NoCellArray`], without the one that the user names.
    pub fn end(self) -> Result<Vec<String>, MeshError> {
        if let (Some(wanted), None) = (&self.wanted, &self.taken) {
            return Err(no_array(wanted, &self.known));
        }
        let guessed = self.taken.iter().filter(|(_, rank)| *rank > 0);
        let guessed =
            guessed.map(|(name, _)| format!("regions are those of the cell array `{name}`"));
        let unused = self.unused.iter().map(|name| {
            format!(
                "the cell array `{name}` of whole numbers is not used: `--region {name}`, in a scene `region_array = \"{name}\"`, takes it for the regions"
            )
        });
        Ok(guessed.chain(unused).collect())
    }
}

/// The failure to find an array by its name among those that are known.
pub(super) fn no_array(wanted: &str, known: &[String]) -> MeshError {
    MeshError::NoCellArray {
        name: wanted.to_owned(),
        known: match known.is_empty() {
            true => "there is none with a number for each cell".to_owned(),
            false => format!(
                "with a number for each cell there are: {}",
                known.join(", ")
            ),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn taken(wanted: Option<&str>, names: &[&str]) -> (Option<String>, Vec<String>) {
        let mut arrays = RegionArrays::new(wanted);
        for name in names {
            let head = Head {
                name,
                width: 1,
                is_whole: !name.ends_with("_f"),
            };
            arrays.takes(head);
        }
        let name = arrays.taken().map(str::to_owned);
        (name, arrays.end().expect("found"))
    }

    #[test]
    fn the_best_known_name_is_taken_and_others_are_told() {
        let (name, notes) = taken(
            None,
            &["labels", "temperature_f", "ids", "MAT_ID", "Region"],
        );
        assert_eq!(name.as_deref(), Some("Region"));
        let told: Vec<_> = notes.iter().map(|n| n.split('`').nth(1)).collect();
        assert_eq!(told, [Some("ids"), Some("MAT_ID"), Some("labels")]);
        assert!(notes[0].contains("--region ids"), "{notes:?}");
        for one in ["labels", "mat_id", "Subdomain-Id", "tetgen:ref"] {
            let (name, notes) = taken(None, &[one]);
            assert_eq!(name.as_deref(), Some(one));
            assert_eq!(notes.len(), 1, "a name that is guessed is told");
        }
        let (name, notes) = taken(Some("ids"), &["region", "ids"]);
        assert_eq!((name.as_deref(), notes.len()), (Some("ids"), 1));
        let mut none = RegionArrays::new(Some("ids"));
        none.takes(Head {
            name: "region",
            width: 1,
            is_whole: true,
        });
        let said = none.end().expect_err("no such array").to_string();
        assert!(
            said.contains("`ids`") && said.contains(": region"),
            "{said}"
        );
    }
}
