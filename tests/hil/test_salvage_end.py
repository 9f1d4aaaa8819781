"""What a salvaged log says of its end, of what was lost and of why, in its report and in the file."""

import pytest
from mcap.records import MessageIndex

from hil.record.log import Log
from hil.record.mcap_file import MAGIC, record_bytes
from hil.record.salvage import salvage
from hil.record.schema import CLEAN, DISK_FULL, PRODUCER_DIED, SALVAGE
from tests.hil.mcap_records import metadata
from tests.hil.rewrite import mcap_summary
from tests.hil.samples import log_of, random_ticks

TICKS = random_ticks(40, seed=8)


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return log_of(TICKS, tmp_path_factory)


def damaged(path, tmp_path, *records, places=1):
    """The log with bytes that are no record, and then records, before the end that it says itself."""
    data, at = path.read_bytes(), mcap_summary(path).metadata_indexes[-1].offset
    file = tmp_path / "damaged.mcap"
    file.write_bytes(data[:at] + (b"\xff" * 5 + metadata("a") * 2) * places + b"".join(records) + data[at:])
    return file


@pytest.mark.parametrize("said", [PRODUCER_DIED, DISK_FULL])
def test_a_damaged_log_that_did_not_end_well_still_says_how_it_ended(path, tmp_path, said):
    data, at = path.read_bytes(), mcap_summary(path).metadata_indexes[-1].offset
    file = tmp_path / "damaged.mcap"
    file.write_bytes(data[:at] + b"\xff" * 5 + metadata("summary", closed=said, ticks="40"))
    report = salvage(file, tmp_path / "out.mcap")
    assert not report.complete
    assert Log.open(tmp_path / "out.mcap").summary.closed == said


def test_one_that_ended_well_is_called_salvaged_once_something_of_it_is_lost(path, tmp_path):
    assert Log.open(path).summary.closed == CLEAN
    salvage(path, tmp_path / "whole.mcap")
    salvage(damaged(path, tmp_path), tmp_path / "out.mcap")
    assert Log.open(tmp_path / "whole.mcap").summary.closed == CLEAN
    assert Log.open(tmp_path / "out.mcap").summary.closed == "salvaged"


@pytest.mark.parametrize("places", [1, 30])
def test_the_new_log_says_the_remarks_that_are_reported_and_no_others(path, tmp_path, places):
    report = salvage(damaged(path, tmp_path, places=places), tmp_path / "out.mcap")
    assert len(report.remarks) == min(places, 21)
    assert Log.open(tmp_path / "out.mcap").metadata[SALVAGE]["remarks"] == "; ".join(report.remarks)


@pytest.mark.parametrize("kept", [60, 5000])
def test_the_bytes_of_a_chunk_in_which_the_file_ends_are_lost(path, tmp_path, kept):
    chunk = mcap_summary(path).chunk_indexes[0]
    assert chunk.chunk_length > kept
    (tmp_path / "cut.mcap").write_bytes(path.read_bytes()[: chunk.chunk_start_offset + kept])
    report = salvage(tmp_path / "cut.mcap", tmp_path / "out.mcap")
    assert report.bytes_lost == kept
    assert Log.open(tmp_path / "out.mcap").metadata[SALVAGE]["bytes_lost"] == str(kept)


def test_a_log_whose_beginning_is_gone_up_to_the_index_of_a_chunk_loses_nothing_else(path, tmp_path):
    index = record_bytes(MessageIndex(channel_id=1, records=[(1, 2)]))
    (tmp_path / "cut.mcap").write_bytes(MAGIC + index + path.read_bytes()[len(MAGIC) :])
    report = salvage(tmp_path / "cut.mcap", tmp_path / "out.mcap")
    assert (report.ticks, report.ticks_lost, report.bytes_lost) == (len(TICKS), 0, 0)
