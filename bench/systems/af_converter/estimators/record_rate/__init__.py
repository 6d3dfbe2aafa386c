"""The pulse rate of one record by four ways of counting."""
