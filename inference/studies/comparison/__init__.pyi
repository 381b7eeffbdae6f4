from .contest import Comparison as Comparison
from .judge import Judgement as Judgement
from .judge import Test as Test
from .judge import judge as judge
from .record import comparison_tree as comparison_tree
from .routes import compare as compare
from .sample import Sample as Sample
from .sample import read_sample as read_sample
