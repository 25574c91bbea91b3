"""Score files: what is read, and one sentence with the line for what is not."""

import hashlib

import numpy as np
import pytest

from refusals import bad_input
from splitknit_match.evaluation.scores import read_scores


def write(folder, text):
    path = folder / "scores.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def test_label_and_score_are_enough(tmp_path):
    path = write(tmp_path, "label,score\n1,0.5\n0,-1e-3\n1,\n0, 7 \n")
    score_file = read_scores(path)
    scores = score_file.scores
    assert scores.label.tolist() == [True, False, True, False]
    np.testing.assert_array_equal(scores.score, [0.5, -1e-3, np.nan, 7.0])
    np.testing.assert_array_equal(read_scores(path, dissimilarity=True).scores.score, -scores.score)
    assert (scores.finger, scores.subject, scores.session, scores.name) == (
        None,
        None,
        None,
        "scores",
    )
    assert score_file.ignored == []
    assert score_file.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()


def test_names_that_were_written_as_texts_come_back(tmp_path):
    path = write(tmp_path, "label,score,finger_a,finger_b\n1,0.5,'=a,'=a\n0,-0.5,@b,'tis\n")
    scores = read_scores(path).scores
    assert scores.finger is not None
    assert set(scores.finger.names) == {"=a", "'tis", "@b"}


def test_everything_there_is(tmp_path):
    path = write(
        tmp_path,
        "\ufeffwhere, score"
        ' ,label,finger_a,finger_b,subject_a,subject_b,session_a,session_b,time\r\n\r\n"here,'
        ' there","0.5",0,9,10,s,t,1,10,8\r\nhere,1.5,1.0,10,10,s,s,1,2,9\r\n',
    )
    score_file = read_scores(path)
    ours = score_file.scores
    assert (ours.name, score_file.ignored) == ("scores", ["where", "time"])
    assert ours.session is not None and ours.finger is not None
    assert ours.session.names == ("1", "2", "10")  # numbers in the order of numbers
    # within their subject
    assert [ours.finger.names[code] for code in ours.finger.codes[0]] == ["s/9", "t/10"]
    assert ours.label.tolist() == [False, True]


def test_lines_are_those_of_the_file_where_fields_hold_line_breaks(tmp_path):
    path = write(tmp_path, 'label,score,note\n1,2,"a\nb"\n0,1,c\n0,x,d\n')
    with bad_input("line 5: a score is a finite number"):
        read_scores(path)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("label,score\n1,1e308\n0,-1e308\n", "line 2: a score is a finite number"),
        ("", "there is no column 'label'"),
        ("  \n\n", "there is no column 'label'"),
        (b"\xef\xbb\xbf", "there is no column 'label'"),
        (b"\xef\xbb\xbf\n\n", "there is no column 'label'"),
        ("label,score\n", "holds no comparison"),
        ("label,value\n1,2\n", "line 1: there is no column 'score'"),
        ("score,truth\n1,2\n", "line 1: there is no column 'label'"),
        ("\n\nscore,truth\n1,2\n", "line 3: there is no column 'label'"),
        ("1,0.5\n0,0.2\n", "line 1: there is no column"),
        (
            "label;score\n1;0.5\n",
            "line 1: there is no column 'label' in 'label;score'; columns apart by commas",
        ),
        ("label,score,score\n1,2,3\n", "line 1: there are two columns 'score'"),
        ("label,score,a,a\n1,2,3,4\n", "line 1: there are two columns 'a'"),
        ("label,score\n1,2\n0\n", "line 3: 2 fields are expected, but there are 1"),
        ("label,score\n1,2\n0,1,5\n", "line 3: 2 fields are expected, but there are 3"),
        ("label,score\n1,2\n2,1\n", "line 3: a label is 1 .* but it is '2'"),
        ("label,score\n-1,2\n", "line 2: a label"),
        ("label,score\n,2\n", "line 2: a label"),
        ("label,score\ngenuine,2\n", "line 2: a label .* 'genuine'"),
        ("label,score\n0.5,2\n", "line 2: a label"),
        ("label,score\n1,2\n0,nan\n", "line 3: a score .* 'nan'"),
        ("label,score\n1,2\n0,NaN\n", "line 3: a score"),
        ("label,score\n1,inf\n", "line 2: a score"),
        ("label,score\n1,-Infinity\n", "line 2: a score"),
        ("label,score\n1,1e999\n", "line 2: a score"),
        ("label,score\n1,1_000\n", "line 2: a score .* '1_000'"),
        ('label,score\n1,"0,5"\n', "line 2: a score .* '0,5'"),
        ("label,score\n1,none\n", "line 2: a score"),
        ("label,score,finger_a\n1,2,3\n", "line 1: there is a column 'finger_a' alone"),
        ("label,score,session_b\n1,2,3\n", "line 1: there is a column 'session_b' alone"),
        ("label,score,finger_a,finger_b\n1,2,3,3\n0,1,,3\n", "line 3: finger_a is blank"),
        ("label,score,system\n1,2,a\n", "a file of its own"),
        ('label,score\n1,"2\n', "is not a CSV file: line 2"),
        (b"\x89PNG\r\n\x1a\n\xff\xff", "is not a CSV file: it is not text"),
        (b"label,score\n1,2\n0,\xff\n", "is not a CSV file: it is not text"),
    ],
)
def test_bad_files(tmp_path, text, words):
    path = write(tmp_path, text)
    with bad_input(words) as caught:
        read_scores(path)
    assert str(caught.value).startswith(str(path))


def test_files_that_are_none(tmp_path):
    with bad_input("does not exist"):
        read_scores(tmp_path / "none.csv")
    with bad_input("not a file"):
        read_scores(tmp_path)
