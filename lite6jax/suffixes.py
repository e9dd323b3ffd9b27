"""The suffixes of the files that are read and written, each in this one place; the readers of recordings have theirs in
`recordings.formats`, which also looks at what a file holds.
"""

WRITTEN_TABLES = (".csv", ".parquet")
"""Of tables that are written, and of recordings that a folder is searched for."""
TEXT_TABLES = (".csv", ".tsv", ".txt", ".dat", ".log")
PARQUET = ".parquet"
LOGS = (".mcap", ".db3", ".bag")
LOG_FILES = (".mcap", ".bag")
"""Of logs that are one file; `.db3` is a part of a folder."""
HDF5 = (".h5", ".hdf5")
NUMPY = (".npz", ".npy")
MATLAB = (".mat",)
WORKBOOKS = (".xlsx", ".xlsm")
PROGRAMS = (".src", ".ls", ".mod")
"""Of programs of KUKA, Fanuc and ABB; KUKA's `.dat` may be a table as well."""
DATA_LIST = ".dat"
YAML = (".yaml", ".yml")
JSON = ".json"
PYTHON = ".py"
XML = ".xml"
ARM_XML = (".urdf", ".xacro", XML, ".mjcf")
DEVIATIONS = ".conf"
"""Of the file in which controllers of Universal Robots keep how an arm deviates from its DH table."""
ARM_FILES = (*YAML, JSON, ".urdf", ".xacro", XML)
CALIBRATIONS = (*YAML, JSON, DEVIATIONS)
MEASUREMENTS = (
    *(suffix for suffix in TEXT_TABLES if suffix != ".txt"),
    PARQUET,
    *LOGS,
    *HDF5,
    *NUMPY,
    *MATLAB,
    *WORKBOOKS,
    *PROGRAMS,
)
"""Of files that hold measurements and describe no arm."""
