"""Records of MCAP as the mcap library has them, and files of nothing else."""

from itertools import accumulate

from mcap.records import Metadata

from hil.record.mcap_file import MAGIC, record_bytes


def metadata(name, **values):
    return record_bytes(Metadata(name=name, metadata=values))


def placed(tmp_path, *records):
    """A file of these records, and where each begins."""
    starts = list(accumulate(map(len, records), initial=len(MAGIC)))
    file = tmp_path / "records.mcap"
    file.write_bytes(MAGIC + b"".join(records))
    return file, starts
