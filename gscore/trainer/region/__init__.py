"""Training a part of a result again while all else stands still."""
